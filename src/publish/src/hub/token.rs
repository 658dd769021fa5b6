//! The token and the address of the Hub, as its own tools take them from the environment. Shows the
//! token to nobody.

use std::{
    ffi::OsString,
    fmt, fs,
    path::{Path, PathBuf},
};

use crate::PublishError;

/// The address of the Hub unless `HF_ENDPOINT` names another one.
pub const ENDPOINT: &str = "https://huggingface.co";
/// Longest token file that is read, in bytes.
const TOKEN_BYTES_MAX: u64 = 4096;

/// A secret that is sent as bearer token.
#[derive(Clone, PartialEq, Eq)]
pub struct HubToken(String);

impl HubToken {
    /// The token of `HF_TOKEN`, else the one that `hf auth login` wrote; `None` if there is neither.
    /// `variable` reads the environment.
    ///
    /// # Errors
    /// Fails if a token is there and cannot be sent.
    pub fn find(variable: &dyn Fn(&str) -> Option<OsString>) -> Result<Option<Self>, PublishError> {
        let named = |name: &str| variable(name).filter(|value| !value.is_empty());
        if let Some(secret) = named("HF_TOKEN") {
            return Self::new(&secret.to_string_lossy(), "HF_TOKEN").map(Some);
        }
        let under = |variable: &str, rest: &str| Some(PathBuf::from(named(variable)?).join(rest));
        let path = named("HF_TOKEN_PATH")
            .map(PathBuf::from)
            .or_else(|| under("HF_HOME", "token"))
            .or_else(|| under("XDG_CACHE_HOME", "huggingface/token"))
            .or_else(|| under("HOME", ".cache/huggingface/token"));
        let Some(path) = path.filter(|path| is_small_file(path)) else {
            return Ok(None);
        };
        let secret = fs::read_to_string(&path).map_err(PublishError::read(&path))?;
        Self::new(&secret, &path.display().to_string()).map(Some)
    }

    fn new(secret: &str, origin: &str) -> Result<Self, PublishError> {
        let secret = secret.trim();
        if !secret.is_empty() && secret.bytes().all(|byte| byte.is_ascii_graphic()) {
            Ok(Self(secret.to_owned()))
        } else {
            let origin = origin.to_owned();
            Err(PublishError::Token { origin })
        }
    }

    pub(super) fn bearer(&self) -> String {
        format!("Bearer {}", self.0)
    }

    /// A text of a server without the token: some repeat it in their errors.
    pub(super) fn redact(&self, text: &str) -> String {
        text.replace(&self.0, "[token]")
    }
}

impl fmt::Debug for HubToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("[token]")
    }
}

fn is_small_file(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|entry| entry.is_file() && entry.len() <= TOKEN_BYTES_MAX)
}

/// The address of a Hub without its last slash, and whether it is on this machine.
///
/// # Errors
/// Fails if it is no address, or one to which a token would go in clear.
pub(super) fn endpoint(text: &str) -> Result<(String, String), PublishError> {
    let text = text.trim().trim_end_matches('/');
    let refuse = |reason: &str| PublishError::Endpoint {
        endpoint: text.split('@').next_back().unwrap_or_default().to_owned(),
        reason: reason.to_owned(),
    };
    let uri: reel_http::ureq::http::Uri = text.parse().map_err(|_| refuse("it cannot be read"))?;
    let host = uri.host().ok_or_else(|| refuse("it names no host"))?;
    if uri.authority().is_some_and(|it| it.as_str().contains('@')) {
        return Err(refuse("it holds a user name or password"));
    }
    if uri.query().is_some() || text.contains('#') {
        return Err(refuse("it holds a query"));
    }
    let is_local = reel_http::is_this_machine(host);
    match uri.scheme_str() {
        Some("https") => {}
        Some("http") if is_local => {}
        Some("http") => {
            return Err(refuse(
                "http:// would send the token in clear; it is for this machine only",
            ));
        }
        _ => return Err(refuse("it has to begin with https://")),
    }
    Ok((text.to_owned(), host.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_found_as_the_hubs_own_tools_do() {
        let folder = tempfile::tempdir().unwrap();
        let cache = folder.path().join("huggingface");
        fs::create_dir(&cache).unwrap();
        fs::write(cache.join("token"), "hf_file\n").unwrap();
        let find = |variables: &[(&str, &Path)]| {
            let read = |name: &str| {
                let found = variables.iter().find(|(it, _)| *it == name)?;
                Some(found.1.as_os_str().to_owned())
            };
            HubToken::find(&read).map(|token| token.map(|token| token.0))
        };
        let (home, named) = (("HF_HOME", &*cache), ("HF_TOKEN", Path::new("hf_named")));
        assert_eq!(find(&[home, named]).unwrap().unwrap(), "hf_named");
        assert_eq!(find(&[home]).unwrap().unwrap(), "hf_file");
        let cache_home = ("XDG_CACHE_HOME", folder.path());
        assert_eq!(find(&[cache_home]).unwrap().unwrap(), "hf_file");
        assert_eq!(find(&[("HOME", folder.path())]).unwrap(), None);
        assert_eq!(find(&[]).unwrap(), None);
        let wrong = find(&[("HF_TOKEN", Path::new("a\nb"))]).unwrap_err();
        assert!(!wrong.to_string().contains('b') || wrong.to_string().contains("HF_TOKEN"));
        assert_eq!(format!("{:?}", HubToken("x".into())), "[token]");
    }

    #[test]
    fn addresses_that_leak_the_token_are_refused() {
        let address = |text: &str| endpoint(text).map(|(text, _)| text);
        assert_eq!(
            address("https://hub.example/").unwrap(),
            "https://hub.example"
        );
        assert_eq!(
            address("http://127.0.0.1:80").unwrap(),
            "http://127.0.0.1:80"
        );
        for wrong in [
            "http://hub.example",
            "hub.example",
            "",
            "ftp://a",
            "https://a:secret@b",
            "https://a?b",
        ] {
            let error = address(wrong).unwrap_err().to_string();
            assert!(!error.contains("secret"), "{error}");
        }
    }
}
