//! The server: a page, and the frames that it asks for. For this computer only, and for reading only.
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
/// Most frames of one answer.
const COUNT_MAX: usize = 480;
/// How long an answer waits for the first frame.
const PATIENCE: Duration = Duration::from_secs(1);
/// Requests that may wait at once: some pages with two each.
const THREADS: usize = 8;

/// A server that listens.
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

    /// Where the page is.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Serve for ever.
    pub fn serve(self, store: &Arc<Store>) {
        let serve = || {
            let (server, store) = (Arc::clone(&self.server), Arc::clone(store));
            thread::spawn(move || {
                while let Ok(request) = server.recv() {
                    // A page that was closed does not take its answer.
                    let _ = answer(request, &store);
                }
            })
        };
        for thread in (0..THREADS).map(|_| serve()).collect::<Vec<_>>() {
            // A thread that panicked has said so; the others go on.
            let _ = thread.join();
        }
    }
}

fn answer(request: Request, store: &Store) -> io::Result<()> {
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
        return request.respond(typed(script.as_bytes().to_vec(), "text/javascript; charset=utf-8"));
    }
    match path {
        "/" => request.respond(typed(PAGE.into(), "text/html; charset=utf-8")),
        "/page.css" => request.respond(typed(STYLE.into(), "text/css; charset=utf-8")),
        "/state" => {
            let state = serde_json::to_vec(&store.state()).map_err(io::Error::other)?;
            request.respond(typed(state, "application/json"))
        }
        "/records" => {
            let count = number("count").map_or(COUNT_MAX, |count: u64| count.min(COUNT_MAX as u64) as usize);
            let (first, records) = store.records(from, count, PATIENCE);
            request.respond(numbered(first, records))
        }
        "/marks" => {
            let (first, marks) = store.marks(from, PATIENCE);
            request.respond(numbered(first, marks))
        }
        _ => request.respond(Response::empty(404)),
    }
}

fn typed(body: Vec<u8>, content_type: &str) -> Response<io::Cursor<Vec<u8>>> {
    with_header(Response::from_data(body), "Content-Type", content_type)
}

fn numbered(first: u64, body: Vec<u8>) -> Response<io::Cursor<Vec<u8>>> {
    with_header(typed(body, "application/octet-stream"), "First-Frame", &first.to_string())
}

fn with_header(
    response: Response<io::Cursor<Vec<u8>>>,
    name: &str,
    value: &str,
) -> Response<io::Cursor<Vec<u8>>> {
    match Header::from_bytes(name, value) {
        Ok(header) => response.with_header(header),
        // Names and values above are plain text.
        Err(()) => response,
    }
}
