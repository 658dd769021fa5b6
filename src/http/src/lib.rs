//! What Reel's clients of HTTP do alike. Models (`reel-llm`), collectors (`reel-otlp`) and the Hub (`reel-publish`)
//! are asked with the same settings, and asked again after the same pauses.

#![forbid(unsafe_code)]

use std::{net::IpAddr, time::Duration};

pub use ureq;
use ureq::{
    Agent,
    config::{Config, ConfigBuilder},
    http::{HeaderMap, header::RETRY_AFTER},
    tls::{RootCerts, TlsConfig},
    typestate::AgentScope,
};

/// Longest pause of our own between two tries.
const PAUSE_MAX: Duration = Duration::from_secs(30);
/// Longest pause that a server may ask for.
const RETRY_AFTER_MAX: Duration = Duration::from_secs(60);

/// Settings for requests to a host; who asks adds its timeouts. Statuses are read, not thrown. A redirect is not
/// followed: keys and tokens go to no other host. Certificates are checked as the operating system does. Proxies
/// come from the environment, but what runs on this machine is asked directly.
#[must_use]
pub fn settings(host: &str) -> ConfigBuilder<AgentScope> {
    let tls = TlsConfig::builder().root_certs(RootCerts::PlatformVerifier);
    let settings = Config::builder()
        .http_status_as_error(false)
        .max_redirects(0)
        .max_redirects_will_error(false)
        .user_agent(concat!("reel/", env!("CARGO_PKG_VERSION")))
        .tls_config(tls.build());
    match is_this_machine(host) {
        true => settings.proxy(None),
        false => settings,
    }
}

/// A client whose requests may take so long, from connecting to the last byte of the answer.
#[must_use]
pub fn agent(host: &str, timeout: Duration) -> Agent {
    let settings = settings(host).timeout_global(Some(timeout));
    settings.build().into()
}

/// Whether a host, as it stands in an address, is this machine: `localhost`, or an address of loopback.
#[must_use]
pub fn is_this_machine(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']');
    host.eq_ignore_ascii_case("localhost")
        || address
            .parse::<IpAddr>()
            .is_ok_and(|address| address.is_loopback())
}

/// What a server asks for in `Retry-After`, where it gives seconds.
#[must_use]
pub fn retry_after(headers: &HeaderMap) -> Option<Duration> {
    let seconds = headers.get(RETRY_AFTER)?.to_str().ok()?.trim().parse();
    seconds.ok().map(Duration::from_secs)
}

/// Before the next try, after so many: what the server asked for, 60 seconds at most; else 1, 2, 4, ... seconds,
/// 30 at most.
#[must_use]
pub fn pause(attempts: u32, asked: Option<Duration>) -> Duration {
    if let Some(asked) = asked {
        return asked.min(RETRY_AFTER_MAX);
    }
    let doublings = attempts.saturating_sub(1);
    let seconds = 1u64.checked_shl(doublings).unwrap_or(u64::MAX);
    Duration::from_secs(seconds).min(PAUSE_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_a_bound() {
        let seconds: Vec<u64> = [0, 1, 2, 3, 5, 6, 64, 65, u32::MAX]
            .into_iter()
            .map(|attempts| pause(attempts, None).as_secs())
            .collect();
        assert_eq!(seconds, [1, 1, 2, 4, 16, 30, 30, 30, 30]);
        assert_eq!(pause(9, Some(Duration::ZERO)), Duration::ZERO);
        assert_eq!(pause(1, Some(Duration::MAX)), RETRY_AFTER_MAX);
    }

    #[test]
    fn names_that_look_like_loopback_are_other_machines() {
        for host in ["localhost", "LocalHost", "127.0.0.1", "127.8.8.8", "[::1]"] {
            assert!(is_this_machine(host), "{host}");
        }
        for host in [
            "127.example.com",
            "localhost.example.com",
            "10.0.0.1",
            "",
            "[::2]",
        ] {
            assert!(!is_this_machine(host), "{host}");
        }
    }

    #[test]
    fn only_seconds_are_understood() {
        let asked = |text: &'static str| {
            let headers = HeaderMap::from_iter([(RETRY_AFTER, text.parse().unwrap())]);
            retry_after(&headers)
        };
        assert_eq!(asked(" 7 "), Some(Duration::from_secs(7)));
        assert_eq!(asked("Wed, 21 Oct 2026 07:28:00 GMT"), None);
        assert_eq!(asked("-1"), None);
        assert_eq!(retry_after(&HeaderMap::new()), None);
    }
}
