//! The names by which requests may call this server. It keeps pages of the web from a server on
//! somebody's own machine: a page that has its own name resolve to 127.0.0.1 (DNS rebinding) still
//! sends that name as `Host`, and its own as `Origin`; one that only has an image loaded from here
//! sends no `Origin`, but browsers say so in `Sec-Fetch-Site`. Pages of listed origins are let
//! through, and their browsers told that they may read the answers (CORS).
//!
//! Compares headers with lists; never resolves a name, and never says who is calling.

use std::{borrow::Cow, net::Ipv6Addr, sync::Arc};

use axum::{
    extract::{Request, State},
    http::{
        HeaderMap, HeaderValue, Method, StatusCode, Uri,
        header::{
            ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS,
            ACCESS_CONTROL_ALLOW_ORIGIN, ACCESS_CONTROL_EXPOSE_HEADERS, ACCESS_CONTROL_MAX_AGE,
            ACCESS_CONTROL_REQUEST_METHOD, HOST, HeaderName, ORIGIN, VARY,
        },
    },
    middleware::Next,
    response::{IntoResponse, Response},
};

/// Hosts that are this machine, wherever the question comes from.
const LOOPBACK: [&str; 3] = ["localhost", "127.0.0.1", "[::1]"];

/// What pages of listed origins may send and read.
const METHODS: HeaderValue = HeaderValue::from_static("GET, HEAD, POST, PUT, DELETE");
const HEADERS: HeaderValue = HeaderValue::from_static(
    "authorization, content-type, mcp-session-id, mcp-protocol-version, mcp-method, mcp-name, last-event-id, range",
);
const EXPOSED: HeaderValue = HeaderValue::from_static("mcp-session-id, content-range");
/// For how many seconds a browser need not ask again.
const MAX_AGE: HeaderValue = HeaderValue::from_static("3600");

/// What requests may say in `Host` and `Origin`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Guard {
    /// Names of this server besides localhost, 127.0.0.1 and `[::1]`, as clients write them:
    /// `reel.example` with any port, or `reel.example:8801` with this one only.
    pub hosts: Vec<String>,
    /// Origins of web pages that may call it, besides its own: `https://lab.example`.
    pub origins: Vec<String>,
}

impl Guard {
    /// Lets a request through, or answers 403 and why. For `axum::middleware::from_fn_with_state`.
    pub async fn middleware(
        State(guard): State<Arc<Self>>,
        request: Request,
        next: Next,
    ) -> Response {
        let page = guard.page(&request);
        if let Some(answer) = page.preflight() {
            return answer;
        }
        let mut response = match guard.check(request.headers(), request.uri()) {
            Ok(()) => next.run(request).await,
            Err(why) => (StatusCode::FORBIDDEN, why).into_response(),
        };
        page.add_cors_headers(&mut response);
        response
    }

    /// Whether a request may come in: it names one host, which is this server, and comes from no
    /// page of somebody else's.
    ///
    /// # Errors
    /// What is wrong with it, and what to do, for who sent it.
    pub fn check(&self, headers: &HeaderMap, uri: &Uri) -> Result<(), String> {
        self.is_of_a_listed_page(headers, uri).map(|_| ())
    }

    /// What the browser behind a request wants to be told. For who calls
    /// [`Guard::check`] and not [`Guard::middleware`]: where there is a
    /// [`BrowserRequest::preflight`] it is the answer, before anything else is looked
    /// at; every other answer goes through [`BrowserRequest::add_cors_headers`].
    pub fn page(&self, request: &Request) -> BrowserRequest {
        let headers = request.headers();
        let is_listed = self.is_of_a_listed_page(headers, request.uri()) == Ok(true);
        let asks = request.method() == Method::OPTIONS
            && headers.contains_key(ACCESS_CONTROL_REQUEST_METHOD);
        BrowserRequest {
            origin: headers.get(ORIGIN).filter(|_| is_listed).cloned(),
            asks,
        }
    }

    /// The first name in the lists that no request can carry.
    pub fn invalid_name(&self) -> Option<&str> {
        let host = self
            .hosts
            .iter()
            .find(|host| Authority::parse(host).is_none());
        host.or_else(|| {
            self.origins
                .iter()
                .find(|origin| Origin::parse(origin).is_none())
        })
        .map(String::as_str)
    }

    /// Whether a request that may come in is one of a page of a listed origin, which is
    /// not this server's own.
    fn is_of_a_listed_page(&self, headers: &HeaderMap, uri: &Uri) -> Result<bool, String> {
        // HTTP/2 and clients of a proxy name the host in the target, alone or as well.
        let mut named = one(headers, &HOST)?
            .into_iter()
            .chain(uri.authority().map(|authority| authority.as_str().into()));
        let name = named
            .next()
            .ok_or("the request says in no Host header which server it wants")?;
        let stranger = || {
            format!(
                "this server is not called {name:?}: reach it as localhost, or list the name under `hosts` in its configuration"
            )
        };
        let host = Authority::parse(&name)
            .filter(|host| self.is_called(host))
            .ok_or_else(stranger)?;
        if let Some(other) = named.find(|other| Authority::parse(other).as_ref() != Some(&host)) {
            return Err(format!("the request wants both {name:?} and {other:?}"));
        }
        if let Some(page) = one(headers, &ORIGIN)? {
            match Origin::parse(&page) {
                Some(origin) if origin.is_of(&host) => {}
                Some(origin) if self.allowed().any(|allowed| allowed == origin) => return Ok(true),
                _ => {
                    let advice = "list the origin under `origins` in its configuration";
                    return Err(format!(
                        "pages of {page:?} may not call this server: {advice}"
                    ));
                }
            }
        }
        if is_drawn_in(headers) {
            let advice = "open the address itself, or ask with an Origin that is listed under `origins` in its configuration";
            return Err(format!("pages of other sites may not load this: {advice}"));
        }
        Ok(false)
    }

    fn is_called(&self, name: &Authority) -> bool {
        let mut hosts = self.hosts.iter().filter_map(|host| Authority::parse(host));
        LOOPBACK.contains(&name.host.as_str())
            || hosts.any(|host| {
                host.host == name.host && (host.port.is_none() || host.port == name.port)
            })
    }

    fn allowed(&self) -> impl Iterator<Item = Origin> {
        self.origins
            .iter()
            .filter_map(|origin| Origin::parse(origin))
    }
}

/// A request, as the browser sees it that sent it for a page.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct BrowserRequest {
    /// Where the page is from, if that is listed.
    origin: Option<HeaderValue>,
    /// Whether the browser only asks for leave to send another.
    asks: bool,
}

impl BrowserRequest {
    /// The answer to a browser that asks what the page may send.
    pub fn preflight(&self) -> Option<Response> {
        if !self.asks || self.origin.is_none() {
            return None;
        }
        let allowed = [
            (ACCESS_CONTROL_ALLOW_METHODS, METHODS),
            (ACCESS_CONTROL_ALLOW_HEADERS, HEADERS),
            (ACCESS_CONTROL_MAX_AGE, MAX_AGE),
        ];
        let mut response = (StatusCode::NO_CONTENT, allowed).into_response();
        self.allow_origin(&mut response);
        Some(response)
    }

    /// Lets the page read an answer.
    pub fn add_cors_headers(&self, response: &mut Response) {
        if self.origin.is_some() {
            response
                .headers_mut()
                .insert(ACCESS_CONTROL_EXPOSE_HEADERS, EXPOSED);
            self.allow_origin(response);
        }
    }

    fn allow_origin(&self, response: &mut Response) {
        if let Some(origin) = &self.origin {
            let headers = response.headers_mut();
            headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, origin.clone());
            headers.append(VARY, HeaderValue::from_static("Origin"));
        }
    }
}

/// Whether a page of another site has something of this server loaded into itself, as a
/// image or a script.
fn is_drawn_in(headers: &HeaderMap) -> bool {
    let says = |name: &str, value: &str| {
        headers
            .get_all(name)
            .iter()
            .any(|said| said.as_bytes().eq_ignore_ascii_case(value.as_bytes()))
    };
    says("sec-fetch-site", "cross-site") && !says("sec-fetch-mode", "navigate")
}

/// The value of a header that may stand once. What is no text comes out as text
/// that is nobody's name.
fn one<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<Cow<'a, str>>, String> {
    let mut values = headers.get_all(name).iter();
    let value = values
        .next()
        .map(|value| String::from_utf8_lossy(value.as_bytes()));
    match values.count() {
        0 => Ok(value),
        more => Err(format!(
            "the request has {} headers '{name}', of which there may be one",
            more + 1
        )),
    }
}

/// A host in the form that is compared, and the port where one is named.
#[derive(PartialEq, Eq, Debug)]
struct Authority {
    host: String,
    port: Option<u16>,
}

impl Authority {
    /// `name`, `name:port`, `[address]` or `[address]:port`; no user, no path, no empty port.
    fn parse(text: &str) -> Option<Self> {
        let (host, port) = match text.strip_prefix('[') {
            Some(rest) => {
                let (address, port) = rest.split_once(']')?;
                (format!("[{}]", address.parse::<Ipv6Addr>().ok()?), port)
            }
            None => {
                let (host, port) = text.split_at(text.find(':').unwrap_or(text.len()));
                (host.to_ascii_lowercase(), port)
            }
        };
        let is_of_a_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_');
        if !host.starts_with('[') && (host.is_empty() || !host.chars().all(is_of_a_name)) {
            return None;
        }
        let port = match port.strip_prefix(':') {
            None if port.is_empty() => None,
            Some(digits) if digits.bytes().all(|byte| byte.is_ascii_digit()) => {
                Some(digits.parse().ok()?)
            }
            _ => return None,
        };
        Some(Self { host, port })
    }
}

/// Where a page comes from; the port is there where the scheme implies one.
#[derive(PartialEq, Eq, Debug)]
struct Origin {
    scheme: String,
    authority: Authority,
}

impl Origin {
    /// `scheme://host` or `scheme://host:port`. `null`, which any page can send, is none.
    fn parse(text: &str) -> Option<Self> {
        let (scheme, authority) = text.split_once("://")?;
        let scheme = scheme.to_ascii_lowercase();
        let mut authority = Authority::parse(authority)?;
        authority.port = authority.port.or(implied_port(&scheme));
        Some(Self { scheme, authority })
    }

    /// Whether the page is one of the server that a request reached. A proxy may have
    /// taken the encryption off.
    fn is_of(&self, server: &Authority) -> bool {
        let Some(implied) = implied_port(&self.scheme) else {
            return false;
        };
        self.authority.host == server.host && self.authority.port == server.port.or(Some(implied))
    }
}

fn implied_port(scheme: &str) -> Option<u16> {
    match scheme {
        "http" => Some(80),
        "https" => Some(443),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use axum::{Router, middleware, routing::get};
    use tokio::{
        io::{AsyncReadExt as _, AsyncWriteExt as _},
        net::{TcpListener, TcpStream},
    };

    use super::*;

    fn guard() -> Guard {
        Guard {
            hosts: ["reel.example", "Lab.Example:8801", "[2001:db8::1]"]
                .map(str::to_owned)
                .into(),
            origins: ["https://pages.example", "http://localhost:3000"]
                .map(str::to_owned)
                .into(),
        }
    }

    /// Why a request with these headers is refused; empty when it is not.
    fn said(target: &str, hosts: &[&[u8]], origins: &[&str]) -> String {
        let mut headers = HeaderMap::new();
        for host in hosts {
            headers.append(HOST, HeaderValue::from_bytes(host).unwrap());
        }
        for origin in origins {
            headers.append(ORIGIN, HeaderValue::from_str(origin).unwrap());
        }
        guard()
            .check(&headers, &target.parse().unwrap())
            .err()
            .unwrap_or_default()
    }

    #[test]
    fn hosts() {
        let ours = "localhost localhost:8801 LOCALHOST:1 127.0.0.1 127.0.0.1:65535 [::1] [::1]:80 [0:0:0:0:0:0:0:1]
            reel.example reel.example:443 Reel.EXAMPLE lab.example:8801 [2001:DB8:0::1]:9";
        for host in ours.split_whitespace() {
            assert_eq!(said("/mcp", &[host.as_bytes()], &[]), "", "{host}");
        }
        let strange = "evil.example evil.example:8801 lab.example lab.example:80 localhost.evil.example evil-localhost localhost.
            127.0.0.2 127.1 0.0.0.0 2130706433 ::1 [::1 [::2] [::1%25lo] [::ffff:127.0.0.1] [localhost] [::1]evil.example [::1]:
            :80 localhost: localhost:x localhost:+80 localhost:65536 localhost:80:80 localhost:80@evil.example
            localhost@evil.example evil.example@localhost localhost/ localhost# localhost? localhost,evil.example
            http://localhost evil.example\\localhost *";
        for host in strange
            .split_whitespace()
            .chain(["", " ", "localhost evil.example"])
        {
            let why = said("/mcp", &[host.as_bytes()], &[]);
            assert!(
                why.starts_with("this server is not called ") && why.contains("`hosts`"),
                "{host}: {why}"
            );
        }
        assert_ne!(said("/mcp", &["l\u{f6}calhost".as_bytes()], &[]), "");
        assert_ne!(said("/mcp", &[b"localhost\xff"], &[]), "");
    }

    #[test]
    fn how_often_a_host_is_named() {
        let (localhost, reel, evil): (&[u8], &[u8], &[u8]) =
            (b"localhost:1", b"reel.example", b"evil.example");
        let cases: [(&str, &[&[u8]], &str); 11] = [
            ("/mcp", &[], "no Host header"),
            ("/mcp", &[localhost, localhost], "2 headers 'host'"),
            ("/mcp", &[localhost, evil], "2 headers 'host'"),
            ("/mcp", &[evil, reel, localhost], "3 headers 'host'"),
            ("http://localhost:1/mcp", &[], ""),
            ("http://LOCALHOST:1/mcp", &[localhost], ""),
            (
                "http://evil.example/mcp",
                &[],
                "not called \"evil.example\"",
            ),
            (
                "http://evil.example/mcp",
                &[localhost],
                "wants both \"localhost:1\" and \"evil.example\"",
            ),
            (
                "http://localhost:1/mcp",
                &[evil],
                "not called \"evil.example\"",
            ),
            ("http://reel.example/mcp", &[localhost], "wants both"),
            (
                "http://localhost:1@evil.example/mcp",
                &[localhost],
                "wants both",
            ),
        ];
        for (target, hosts, expected) in cases {
            let why = said(target, hosts, &[]);
            assert!(
                why.contains(expected) && why.is_empty() == expected.is_empty(),
                "{target} {hosts:?}: {why}"
            );
        }
    }

    #[test]
    fn origins() {
        let ours = [
            ("localhost:8801", "http://localhost:8801"),
            ("LocalHost:8801", "HTTP://LOCALHOST:8801"),
            ("localhost", "http://localhost"),
            ("localhost", "http://localhost:80"),
            ("localhost:80", "http://localhost"),
            ("127.0.0.1:8801", "http://127.0.0.1:8801"),
            ("[::1]:8801", "http://[0::1]:8801"),
            ("reel.example", "https://reel.example"),
            ("reel.example:8443", "https://reel.example:8443"),
            ("localhost:8801", "https://pages.example"),
            ("localhost:8801", "https://pages.example:443"),
            ("localhost:8801", "http://localhost:3000"),
        ];
        for (host, origin) in ours {
            assert_eq!(
                said("/mcp", &[host.as_bytes()], &[origin]),
                "",
                "{origin} to {host}"
            );
        }
        let strange = "null NULL http://evil.example http://localhost:8802 http://localhost http://127.0.0.1:8801
            http://pages.example https://pages.example:444 https://pages.example.evil.example ftp://localhost:8801
            http://localhost:8801@evil.example http://evil.example@localhost:8801 http://user:pass@localhost:8801
            http://localhost:8801/ http://localhost:8801/evil http://localhost:8801,http://evil.example http:localhost:8801
            //localhost:8801 localhost:8801 http:// *";
        for origin in strange
            .split_whitespace()
            .chain(["", "http://localhost:8801 http://evil.example"])
        {
            let why = said("/mcp", &[b"localhost:8801"], &[origin]);
            assert!(
                why.starts_with("pages of ") && why.contains("`origins`"),
                "{origin}: {why}"
            );
        }
        let twice = said(
            "/mcp",
            &[b"localhost:8801"],
            &["http://localhost:8801", "http://localhost:8801"],
        );
        assert!(twice.contains("2 headers 'origin'"), "{twice}");
        // A page that rebound its own name is of the same origin as what it calls.
        assert_ne!(
            said("/mcp", &[b"evil.example"], &["http://evil.example"]),
            ""
        );
    }

    #[test]
    fn mistakes_in_the_lists() {
        assert_eq!(guard().invalid_name(), None);
        for host in [
            "https://reel.example",
            "reel.example/",
            "*.example",
            "::1",
            "user@reel.example",
            "",
        ] {
            assert_eq!(
                Guard {
                    hosts: vec![host.to_owned()],
                    ..guard()
                }
                .invalid_name(),
                Some(host)
            );
        }
        for origin in [
            "reel.example",
            "https://reel.example/",
            "https://*.example",
            "null",
            "",
        ] {
            assert_eq!(
                Guard {
                    origins: vec![origin.to_owned()],
                    ..guard()
                }
                .invalid_name(),
                Some(origin)
            );
        }
    }

    /// Serves `/mcp` behind a guard, until the test ends.
    async fn serve(guard: Guard) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let router = Router::new()
            .route("/mcp", get(|| async { ([("mcp-session-id", "7")], "in") }))
            .layer(middleware::from_fn_with_state(
                Arc::new(guard),
                Guard::middleware,
            ));
        tokio::spawn(async move { axum::serve(listener, router).await });
        address
    }

    /// The whole answer to a request of these lines.
    async fn ask(address: SocketAddr, request: &str) -> String {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream
            .write_all(format!("{request}Connection: close\r\n\r\n").as_bytes())
            .await
            .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        answer
    }

    #[tokio::test]
    async fn every_route_is_guarded_as_requests_come_over_the_wire() {
        let address = serve(Guard::default()).await;
        #[rustfmt::skip]
        let cases = [
            ("GET /mcp HTTP/1.1\r\nHost: localhost:8801\r\n", "200"),
            (
                "GET /mcp HTTP/1.1\r\nhOsT:\t127.0.0.1 \r\nOrigin: http://127.0.0.1\r\n",
                "200",
            ),
            ("GET /mcp HTTP/1.0\r\nHost: [::1]\r\n", "200"),
            (
                "GET http://localhost/mcp HTTP/1.1\r\nHost: localhost\r\n",
                "200",
            ),
            ("GET /none HTTP/1.1\r\nHost: localhost\r\n", "404"),
            ("GET /mcp HTTP/1.1\r\n", "403"),
            ("GET /mcp HTTP/1.0\r\n", "403"),
            ("GET /mcp HTTP/1.1\r\nHost:\r\n", "403"),
            ("GET /mcp HTTP/1.1\r\nHost: evil.example\r\n", "403"),
            ("GET /none HTTP/1.1\r\nHost: evil.example\r\n", "403"),
            (
                "OPTIONS /mcp HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n",
                "403",
            ),
            ("GET /mcp HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n", "403"),
            ("GET /mcp HTTP/1.1\r\nHost: localhost\r\nOrigin: null\r\n", "403"),
            (
                "GET http://evil.example/mcp HTTP/1.1\r\nHost: localhost\r\n",
                "403",
            ),
        ];
        for (request, status) in cases {
            let answer = ask(address, request).await;
            assert_eq!(answer.split(' ').nth(1), Some(status), "{request}{answer}");
            assert!(
                status != "403" || answer.contains("content-type: text/plain"),
                "{answer}"
            );
        }
    }

    #[tokio::test]
    async fn browsers_are_told_what_pages_of_listed_origins_may_do() {
        let address = serve(guard()).await;
        let asks = "Access-Control-Request-Method: POST\r\nAccess-Control-Request-Headers: mcp-session-id\r\n";
        let request = |method: &str, host: &str, origin: &str, more: &str| {
            format!("{method} /mcp HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n{more}")
        };
        let listed = "https://pages.example";
        let preflight = ask(address, &request("OPTIONS", "localhost:8801", listed, asks)).await;
        assert!(preflight.starts_with("HTTP/1.1 204 "), "{preflight}");
        let headers = "authorization, content-type, mcp-session-id, mcp-protocol-version, mcp-method, mcp-name, last-event-id, range";
        for line in [
            "access-control-allow-origin: https://pages.example",
            "access-control-allow-methods: GET, HEAD, POST, PUT, DELETE",
            &format!("access-control-allow-headers: {headers}"),
            "access-control-max-age: 3600",
            "vary: Origin",
        ] {
            assert!(
                preflight.contains(&format!("\r\n{line}\r\n")),
                "{line} in {preflight}"
            );
        }
        let answer = ask(
            address,
            &request(
                "GET",
                "localhost:8801",
                listed,
                "Sec-Fetch-Site: cross-site\r\n",
            ),
        )
        .await;
        assert!(
            answer.starts_with("HTTP/1.1 200 ") && answer.ends_with("\r\n\r\nin"),
            "{answer}"
        );
        for line in [
            "access-control-allow-origin: https://pages.example",
            "access-control-expose-headers: mcp-session-id, content-range",
            "vary: Origin",
        ] {
            assert!(
                answer.contains(&format!("\r\n{line}\r\n")),
                "{line} in {answer}"
            );
        }
        // An OPTIONS that asks for nothing is a request like another.
        let answer = ask(address, &request("OPTIONS", "localhost:8801", listed, "")).await;
        assert!(
            answer.starts_with("HTTP/1.1 405 ") && answer.contains("access-control-allow-origin: "),
            "{answer}"
        );
        for (host, origin, status) in [
            ("localhost:8801", "http://evil.example", "403"),
            ("localhost:8801", "null", "403"),
            ("evil.example", listed, "403"),
            ("localhost:8801", "http://localhost:8801", "405"),
        ] {
            let answer = ask(address, &request("OPTIONS", host, origin, asks)).await;
            assert_eq!(
                answer.split(' ').nth(1),
                Some(status),
                "{origin} to {host}: {answer}"
            );
            assert!(
                !answer.contains("access-control-"),
                "{origin} to {host}: {answer}"
            );
        }
    }

    #[tokio::test]
    async fn pages_of_other_sites_load_nothing() {
        let address = serve(guard()).await;
        // site, mode, more headers, status
        let cases = [
            ("cross-site", "no-cors", "Sec-Fetch-Dest: image\r\n", "403"),
            ("Cross-Site", "", "", "403"),
            ("cross-site", "cors", "Origin: http://localhost\r\n", "403"),
            ("cross-site", "navigate", "", "200"),
            (
                "cross-site",
                "cors",
                "Origin: https://pages.example\r\n",
                "200",
            ),
            (
                "cross-site",
                "navigate",
                "Origin: http://evil.example\r\n",
                "403",
            ),
            ("same-origin", "no-cors", "", "200"),
            ("same-site", "no-cors", "", "200"),
            ("none", "navigate", "", "200"),
        ];
        for (site, mode, more, status) in cases {
            let mode = match mode {
                "" => String::new(),
                mode => format!("Sec-Fetch-Mode: {mode}\r\n"),
            };
            let headers = format!("sec-fetch-site: {site}\r\n{mode}{more}");
            let answer = ask(
                address,
                &format!("GET /mcp HTTP/1.1\r\nHost: localhost\r\n{headers}"),
            )
            .await;
            assert_eq!(answer.split(' ').nth(1), Some(status), "{headers}{answer}");
        }
    }
}
