//! The server: a page, and the frames that it asks for. For this computer only, and for reading only: a request that
//! names another host is refused, so that no page of the web reads the data through a name that it points here.
//!
//! | path | answer |
//! |---|---|
//! | `/` | the page |
//! | `/state` | [`State`](super::store::State) as JSON |
//! | `/records?from=N&count=M` | records from frame N on, at most M; the header `First-Frame` says where they begin |
//! | `/marks?from=N` | one byte per frame from N on, see [`Record::mark`](super::record::Record::mark) |
//!
//! The last two wait for up to a second where there is nothing yet.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use tiny_http::{Header, Method, Request, Response, Server};

use super::store::Store;

const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
const SCRIPTS: [(&str, &str); 3] = [
    ("/record.js", include_str!("page/record.js")),
    ("/draw.js", include_str!("page/draw.js")),
    ("/page.js", include_str!("page/page.js")),
];
const BYTES: &str = "application/octet-stream";
const COUNT_MAX: usize = 480;
/// How long an answer waits for its first frame.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Requests that may wait at once: two for each page.
const THREADS: usize = 8;

pub struct PageServer {
    server: Arc<Server>,
    address: SocketAddr,
}

impl PageServer {
    /// Listen on this port of this computer; 0: any that is free.
    pub fn bind(port: u16) -> Result<Self> {
        let address = (Ipv4Addr::LOCALHOST, port);
        let server = Server::http(address).map_err(|error| anyhow!("{error}"));
        let server = server.with_context(|| format!("port {port}: cannot listen on it"))?;
        let address = server.server_addr().to_ip().context("the server has no address")?;
        Ok(Self { server: Arc::new(server), address })
    }

    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    pub fn serve(self, store: &Arc<Store>) {
        let serve = || {
            let (server, store, port) = (Arc::clone(&self.server), Arc::clone(store), self.address.port());
            thread::spawn(move || {
                while let Ok(request) = server.recv() {
                    // A page that was closed does not take its answer.
                    let _ = answer(request, &store, port);
                }
            })
        };
        for thread in (0..THREADS).map(|_| serve()).collect::<Vec<_>>() {
            // A thread that panicked has said so; the others go on.
            let _ = thread.join();
        }
    }
}

fn answer(request: Request, store: &Store, port: u16) -> io::Result<()> {
    if !is_own_host(&request, port) {
        return request.respond(Response::empty(403));
    }
    if *request.method() != Method::Get {
        return request.respond(Response::empty(405));
    }
    let url = request.url().to_owned();
    let (path, query) = url.split_once('?').unwrap_or((&url, ""));
    let number = |name: &str| {
        query.split('&').filter_map(|pair| pair.split_once('=')).find(|(key, _)| *key == name)?.1.parse().ok()
    };
    let from = number("from").unwrap_or(0);
    if let Some((_, script)) = SCRIPTS.iter().find(|(name, _)| *name == path) {
        return request.respond(typed((*script).into(), "text/javascript; charset=utf-8", None));
    }
    match path {
        "/" => request.respond(typed(PAGE.into(), "text/html; charset=utf-8", None)),
        "/page.css" => request.respond(typed(STYLE.into(), "text/css; charset=utf-8", None)),
        "/state" => {
            let state = serde_json::to_vec(&store.state()).map_err(io::Error::other)?;
            request.respond(typed(state, "application/json", None))
        }
        "/records" => {
            let count = number("count").map_or(COUNT_MAX, |count: u64| count.min(COUNT_MAX as u64) as usize);
            let (first, records) = store.records(from, count, TIMEOUT);
            request.respond(typed(records, BYTES, Some(first)))
        }
        "/marks" => {
            let (first, marks) = store.marks(from, TIMEOUT);
            request.respond(typed(marks, BYTES, Some(first)))
        }
        _ => request.respond(Response::empty(404)),
    }
}

fn is_own_host(request: &Request, port: u16) -> bool {
    let mut hosts = request.headers().iter().filter(|header| header.field.equiv("Host"));
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    hosts.next().is_some_and(|host| own.iter().any(|own| host.value.as_str() == own))
        && hosts.next().is_none()
}

/// A body with its type, and where it begins in the session if it is a part.
fn typed(body: Vec<u8>, content_type: &str, first: Option<u64>) -> Response<io::Cursor<Vec<u8>>> {
    let first = first.map(|first| ("First-Frame", first.to_string()));
    let headers = [("Content-Type", content_type.to_owned())].into_iter().chain(first);
    // Names and values are plain text: none is refused.
    let headers = headers.filter_map(|(name, value)| Header::from_bytes(name, value).ok());
    headers.fold(Response::from_data(body), Response::with_header)
}
