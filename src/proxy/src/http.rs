//! Agents and a server over HTTP/1.1: each connection of an agent has one of its own to the server,
//! and what is said on one is said on the other, byte for byte, but for two headers of requests
//! (`Host`, `Accept-Encoding`). Both ways are threads.

use std::{
    io,
    net::{IpAddr, SocketAddr, TcpListener, TcpStream, ToSocketAddrs},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use reel_redact::Rules;

use crate::{
    ProxyError, Setup,
    connection::{Connection, Streams, answer},
    sessions::Sessions,
    sse, stop,
    tls::Tls,
    wire::{Head, Start},
};

/// Connections at a time.
const CONNECTIONS_MAX: usize = 8192;
/// How long the server may take to accept a connection.
const CONNECT_PATIENCE: Duration = Duration::from_secs(10);
/// How often silent sessions are looked for.
const TEND_EVERY: Duration = Duration::from_secs(5);

/// Where the server is.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Upstream {
    host: String,
    port: u16,
    /// As it stands in `Host`.
    authority: String,
    path: String,
    encrypted: bool,
}

impl Upstream {
    /// Reads `http://HOST[:PORT][/PATH]`, or the same with `https`.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(url: &str) -> Result<Self, ProxyError> {
        let wrong = |what| ProxyError::Url {
            url: Rules::built_in().without_secrets(url),
            problem: what,
        };
        let schemes = [("http://", false), ("https://", true)];
        let (rest, encrypted) = schemes
            .iter()
            .find_map(|(scheme, encrypted)| Some((url.strip_prefix(scheme)?, *encrypted)))
            .ok_or_else(|| wrong("the address of the server begins with http:// or https://"))?;
        let (authority, path) = rest.split_at(rest.find(['/', '?']).unwrap_or(rest.len()));
        if authority.is_empty() || authority.contains('@') {
            return Err(wrong("the address of the server names a host, and no user"));
        }
        let (host, port) = match authority.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => (
                host,
                port.parse()
                    .map_err(|_| wrong("the port is no number up to 65535"))?,
            ),
            _ => (authority, if encrypted { 443 } else { 80 }),
        };
        let host = host
            .trim_start_matches('[')
            .trim_end_matches(']')
            .to_owned();
        Ok(Self {
            host,
            port,
            authority: authority.to_owned(),
            path: path.to_owned(),
            encrypted,
        })
    }

    /// What agents call behind this recorder's address: the path that was given.
    pub fn path(&self) -> &str {
        &self.path
    }

    fn connect(&self) -> io::Result<TcpStream> {
        let mut last = io::Error::new(
            io::ErrorKind::NotFound,
            "the name of the server leads to no address",
        );
        for address in (self.host.as_str(), self.port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, CONNECT_PATIENCE) {
                Ok(stream) => return Ok(stream),
                Err(error) => last = error,
            }
        }
        Err(last)
    }
}

/// What all connections share.
pub(crate) struct Shared {
    pub setup: Arc<Setup>,
    pub upstream: Upstream,
    /// Where the server is spoken to over TLS.
    tls: Option<Tls>,
    pub sessions: Sessions,
    /// Open streams of HTTP+SSE, by the target for messages.
    pub streams: Streams,
    connections: AtomicUsize,
}

impl Shared {
    /// A connection to the server, in the clear at this end.
    fn connect(&self) -> io::Result<TcpStream> {
        let server = self.upstream.connect()?;
        match &self.tls {
            Some(tls) => tls.connect(server, &self.upstream.host),
            None => Ok(server),
        }
    }

    /// The bytes of a request's head as the server gets them. What is compressed could
    /// not be read here.
    pub(crate) fn for_the_server(&self, head: &Head) -> Vec<u8> {
        head.with_values(&[
            ("host", self.upstream.authority.as_str()),
            ("accept-encoding", "identity"),
        ])
    }

    /// A response's head as the agent gets it: an address of the server that it is redirected to keeps path and query
    /// alone, so that the agent does not go past the recorder.
    pub(crate) fn for_the_agent(&self, head: Head) -> Head {
        let redirects =
            matches!(head.start, Start::Response { status } if (300..400).contains(&status));
        let path = head
            .value("location")
            .filter(|_| redirects)
            .filter(|address| self.is_of_the_server(address))
            .and_then(sse::behind_the_server);
        let Some(path) = path else {
            return head;
        };
        let bytes = head.with_values(&[("location", path)]);
        Head::response(&bytes).ok().flatten().unwrap_or(head)
    }

    fn is_of_the_server(&self, address: &str) -> bool {
        let authority = address
            .split_once("://")
            .and_then(|(_, rest)| rest.split(['/', '?', '#']).next());
        authority.is_some_and(|authority| authority.eq_ignore_ascii_case(&self.upstream.authority))
    }

    /// What is wrong with the name by which a request calls us. A page of the web that has its own
    /// name lead to this machine (DNS rebinding) still sends that name; and the server, which gets
    /// another `Host` from us, could not tell.
    pub(crate) fn rejected_client(&self, head: &Head) -> Option<String> {
        let host = head.value("host")?;
        let name = match host.rsplit_once(':') {
            Some((name, port)) if !port.ends_with(']') => name,
            _ => host,
        };
        let name = name.trim_start_matches('[').trim_end_matches(']');
        let known = name.eq_ignore_ascii_case("localhost")
            || name.parse::<IpAddr>().is_ok()
            || name.eq_ignore_ascii_case(&self.upstream.host)
            || self
                .setup
                .hosts
                .iter()
                .any(|host| host.eq_ignore_ascii_case(name));
        (!known).then(|| {
            format!("reel record is not called {name:?} here: reach it by its address, or start it with --host {name}\n")
        })
    }
}

/// A recorder that listens.
pub struct Proxy {
    listener: TcpListener,
    shared: Arc<Shared>,
}

impl Proxy {
    /// Listens for agents.
    ///
    /// # Errors
    /// When the address cannot be had, or for https the authorities that this machine trusts.
    pub fn bind(
        setup: Arc<Setup>,
        upstream: Upstream,
        address: SocketAddr,
    ) -> Result<Self, ProxyError> {
        let listener =
            TcpListener::bind(address).map_err(|source| ProxyError::Listen { address, source })?;
        let tls = if upstream.encrypted {
            Some(Tls::new().map_err(ProxyError::Tls)?)
        } else {
            None
        };
        let sessions = Sessions::new(setup.clone());
        let shared = Shared {
            setup,
            upstream,
            tls,
            sessions,
            streams: Streams::default(),
            connections: AtomicUsize::new(0),
        };
        Ok(Self {
            listener,
            shared: Arc::new(shared),
        })
    }

    /// Passes on and records from now on, until nobody is left to do it for.
    #[cfg(test)]
    pub(crate) fn start(self) -> Arc<Shared> {
        let shared = self.shared.clone();
        thread::spawn(move || accept(&self.listener, &self.shared));
        shared
    }

    /// Where it listens.
    ///
    /// # Errors
    /// When the system does not say.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Passes on and records until the process shall end; then every episode is ended
    /// and its trace whole.
    ///
    /// # Errors
    /// When the system does not say when that is.
    pub fn run(self) -> Result<(), ProxyError> {
        let Self { listener, shared } = self;
        let tended = shared.clone();
        thread::spawn(move || {
            loop {
                thread::sleep(TEND_EVERY.min(tended.setup.idle));
                tended.sessions.end_idle();
            }
        });
        let accepting = shared.clone();
        thread::spawn(move || accept(&listener, &accepting));
        stop::wait()?;
        shared.sessions.end_all("the recorder was stopped");
        shared.setup.endings.wait();
        Ok(())
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for agent in listener.incoming() {
        let Ok(agent) = agent else {
            // Out of file descriptors, say: it passes.
            thread::sleep(Duration::from_millis(100));
            continue;
        };
        let shared = shared.clone();
        thread::spawn(move || {
            if shared.connections.fetch_add(1, Ordering::Relaxed) < CONNECTIONS_MAX {
                serve(&agent, &shared);
            }
            shared.connections.fetch_sub(1, Ordering::Relaxed);
        });
    }
}

/// Passes on what both sides of a connection say, until one is gone.
fn serve(agent: &TcpStream, shared: &Arc<Shared>) {
    let server = match shared.connect() {
        Ok(server) => server,
        Err(error) => {
            let why = why_unreachable(&shared.upstream.authority, &error, shared.tls.is_some());
            drop(answer(agent, "502 Bad Gateway", "text/plain", &why));
            return;
        }
    };
    let _ = agent
        .set_nodelay(true)
        .and_then(|()| server.set_nodelay(true));
    // Both are over as soon as one breaks off.
    drop(Connection::new(shared, agent, &server).map(|connection| connection.run(agent, &server)));
}

/// Why the server cannot be reached, and what to do about it.
fn why_unreachable(authority: &str, error: &io::Error, is_encrypted: bool) -> String {
    let error = error.to_string();
    let (why, hint) = match is_encrypted {
        // The name that the verifier gives it, which has no type that can be had here.
        true if error.contains("CaUsedAsEndEntity") => (
            "its certificate is that of a certificate authority, which cannot be a server's own",
            "; make one for the server with -addext basicConstraints=critical,CA:FALSE (openssl req -x509) and name it \
             with SSL_CERT_FILE, or have it signed by an authority that SSL_CERT_FILE names",
        ),
        true => (
            error.as_str(),
            "; it has to have a certificate of an authority that this machine trusts, or that SSL_CERT_FILE names",
        ),
        false => (error.as_str(), ""),
    };
    format!("reel record cannot reach the server {authority}: {why}{hint}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_with_the_certificate_of_an_authority_is_told_what_to_do() {
        let told = |why: &str, is_encrypted: bool| {
            let error = io::Error::new(io::ErrorKind::InvalidData, why.to_owned());
            why_unreachable("robot:8443", &error, is_encrypted)
        };
        let authority = told(
            "invalid peer certificate: Other(OtherError(CaUsedAsEndEntity))",
            true,
        );
        for part in ["robot:8443", "CA:FALSE", "signed by", "SSL_CERT_FILE"] {
            assert!(authority.contains(part), "{part}, {authority}");
        }
        assert!(!authority.contains("OtherError"), "{authority}");
        let unknown = told("invalid peer certificate: UnknownIssuer", true);
        assert!(
            unknown.contains("UnknownIssuer; it has to have a certificate"),
            "{unknown}"
        );
        assert!(!unknown.contains("CA:FALSE"), "{unknown}");
        assert!(!told("refused", false).contains("certificate"));
    }

    #[test]
    fn addresses_of_servers() {
        let parse = |url: &str| {
            Upstream::parse(url)
                .map(|it| (it.host, it.port, it.path))
                .map_err(|error| error.to_string())
        };
        assert_eq!(
            parse("http://robot:8000/sse"),
            Ok(("robot".into(), 8000, "/sse".into()))
        );
        assert_eq!(
            parse("http://[::1]:80"),
            Ok(("::1".into(), 80, String::new()))
        );
        assert_eq!(parse("http://[::1]/x"), Ok(("::1".into(), 80, "/x".into())));
        assert_eq!(
            parse("http://robot"),
            Ok(("robot".into(), 80, String::new()))
        );
        assert_eq!(
            parse("https://robot/mcp"),
            Ok(("robot".into(), 443, "/mcp".into()))
        );
        for bad in [
            "robot:1",
            "ftp://robot",
            "http://",
            "http://a@b",
            "http://robot:99999",
        ] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
