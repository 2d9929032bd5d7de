//! The server: a page, and the frames that it asks for. For this computer only, and for reading only: a request that
//! names another host is refused, so that no page of the web reads the data through a name that it points here.
//!
//! `/` is the page, `/sessions` the number of sessions as JSON, `/0/records?from=7` what the first session answers to
//! `records?from=7`: see [`Frames::answer`]. The header `First-Frame` says where frames begin. An answer with frames
//! waits for up to a second where there is none yet.

use std::fmt::Display;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use tiny_http::{Header, Method, Request, Response, Server};

use slipsense_view::frames::{Answer, Frames};
use slipsense_view::page;
use slipsense_view::record::Record;

/// How long an answer waits for its first frame.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Requests that may wait at once: two for each session of a page.
const THREADS: usize = 16;

/// The frames of a session, between their source and the pages.
pub struct Shared {
    frames: Mutex<Frames>,
    changed: Condvar,
}

impl Shared {
    pub fn new(frames: Frames) -> Self {
        Self { frames: Mutex::new(frames), changed: Condvar::new() }
    }

    /// Take all frames, as fast as they come; an error ends them.
    pub fn fill<E: Display>(&self, records: impl Iterator<Item = Result<Record, E>>) -> Result<(), String> {
        for record in records {
            let record = record.map_err(|error| error.to_string())?;
            self.lock().push(&record);
            self.changed.notify_all();
        }
        Ok(())
    }

    /// There will be no more frames; `problem`: what went wrong.
    pub fn end(&self, problem: Option<String>) {
        self.lock().end(problem);
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, Frames> {
        // Every change is complete before the lock is released.
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn answer(&self, request: &str) -> Option<Answer> {
        let from = request.split_once("?from=").and_then(|(_, from)| from.parse().ok()).unwrap_or(0);
        let is_waiting = |frames: &mut Frames| frames.state().end <= from && !frames.state().ended;
        if !request.contains('?') {
            return self.lock().answer(request);
        }
        let waited = self.changed.wait_timeout_while(self.lock(), TIMEOUT, is_waiting);
        waited.unwrap_or_else(PoisonError::into_inner).0.answer(request)
    }
}

pub struct PageServer {
    server: Server,
    address: SocketAddr,
}

impl PageServer {
    /// Listen on this port of this computer; 0: any that is free.
    pub fn bind(port: u16) -> Result<Self> {
        let address = (Ipv4Addr::LOCALHOST, port);
        let server = Server::http(address).map_err(|error| anyhow!("{error}"));
        let server = server.with_context(|| format!("port {port}: cannot listen on it"))?;
        let address = server.server_addr().to_ip().context("the server has no address")?;
        Ok(Self { server, address })
    }

    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    pub fn serve(&self, sessions: &[Shared]) {
        let serve = || {
            while let Ok(request) = self.server.recv() {
                // A page that was closed does not take its answer.
                let _ = answer(request, sessions, self.address.port());
            }
        };
        thread::scope(|scope| {
            let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(serve)).collect();
            // A thread that panicked has said so; the others go on.
            threads.into_iter().for_each(|thread| drop(thread.join()));
        });
    }
}

fn answer(request: Request, sessions: &[Shared], port: u16) -> io::Result<()> {
    if !is_own_host(&request, port) {
        return request.respond(Response::empty(403));
    }
    if *request.method() != Method::Get {
        return request.respond(Response::empty(405));
    }
    let path = request.url().trim_start_matches('/').to_owned();
    let found = if path.is_empty() {
        Some(("text/html; charset=utf-8", None, page(None).into_bytes()))
    } else if path == "sessions" {
        Some(("application/json", None, sessions.len().to_string().into_bytes()))
    } else {
        let session = |(number, ask): (&str, _)| Some((sessions.get(number.parse::<usize>().ok()?)?, ask));
        let answer = path.split_once('/').and_then(session).and_then(|(session, ask)| session.answer(ask));
        answer.map(|answer| ("application/octet-stream", answer.first, answer.body))
    };
    let Some((kind, first, body)) = found else { return request.respond(Response::empty(404)) };
    // Where the body begins in the session, if it is a part.
    let first = first.map(|first: u64| ("First-Frame", first.to_string()));
    let headers = [("Content-Type", kind.to_owned())].into_iter().chain(first);
    // Names and values are plain text: none is refused.
    let headers = headers.filter_map(|(name, value)| Header::from_bytes(name, value).ok());
    request.respond(headers.fold(Response::from_data(body), Response::with_header))
}

fn is_own_host(request: &Request, port: u16) -> bool {
    let mut hosts = request.headers().iter().filter(|header| header.field.equiv("Host"));
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    hosts.next().is_some_and(|host| own.iter().any(|own| host.value.as_str() == own))
        && hosts.next().is_none()
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;

    #[test]
    fn only_its_own_host_name_is_answered() {
        let server = super::PageServer::bind(0).unwrap();
        let address = server.url().trim_start_matches("http://").trim_end_matches('/').to_owned();
        let port = address.rsplit_once(':').unwrap().1.to_owned();
        std::thread::spawn(move || server.serve(&[]));
        let status = |host: &str| {
            let mut stream = TcpStream::connect(&address).unwrap();
            write!(stream, "GET /sessions HTTP/1.1\r\n{host}Connection: close\r\n\r\n").unwrap();
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            answer.split(' ').nth(1).unwrap().to_owned()
        };
        for host in [address.clone(), format!("localhost:{port}")] {
            assert_eq!(status(&format!("Host: {host}\r\n")), "200", "{host}");
        }
        for host in ["evil.example", "127.0.0.1", &format!("evil.example:{port}")] {
            assert_eq!(status(&format!("Host: {host}\r\n")), "403", "{host}");
        }
        assert_eq!(status(""), "403");
    }
}
