//! The Hub's HTTP API as far as publishing needs it: what a repository holds, and a new state of it
//! in commits. Large files go to the storage behind Git LFS, small ones into the commit.
//!
//! Reads no environment and owns no clock; sends the token to no other host.

mod http;
mod lfs;
mod token;
mod upload;

use std::{collections::BTreeMap, ffi::OsString};

use reel_http::ureq::http::Method;
use serde_json::{Value, json};

use crate::{ExistingFile, FileDigest, PublishError, RepositoryId};
use http::{Body, Call, Http, Response};

pub use http::Pause;
pub use token::{ENDPOINT, HubToken};
pub use upload::{CommitOptions, PublishedCommit};

/// Most files that are read of a repository's tree.
const TREE_FILES_MAX: usize = 200_000;
/// The branch that every repository has.
pub const MAIN: &str = "main";

/// A client of one Hub.
pub struct Hub {
    http: Http,
}

/// What a repository is.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RepositoryInfo {
    /// Whether only its owner sees it.
    pub private: bool,
}

/// The files of a repository at a revision.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct RepositoryTree {
    /// The files by path, with the digests by which the Hub knows them.
    pub files: BTreeMap<String, ExistingFile>,
    /// The commit whose files they are; `None` if there is no such revision yet.
    pub commit: Option<String>,
}

impl Hub {
    /// A client; nothing is asked yet.
    ///
    /// # Errors
    /// Fails if the address cannot be one.
    pub fn new(
        endpoint: &str,
        token: Option<HubToken>,
        pause: Pause,
    ) -> Result<Self, PublishError> {
        Ok(Self {
            http: Http::new(endpoint, token, pause)?,
        })
    }

    /// A client by the environment, as the Hub's own tools read it: `HF_ENDPOINT`, `HF_TOKEN` and
    /// the token file of `hf auth login`.
    ///
    /// # Errors
    /// Fails if the address or the token cannot be one.
    pub fn from_environment(
        variable: &dyn Fn(&str) -> Option<OsString>,
        pause: Pause,
    ) -> Result<Self, PublishError> {
        let endpoint = variable("HF_ENDPOINT").filter(|value| !value.is_empty());
        let endpoint = endpoint.map(|value| value.to_string_lossy().into_owned());
        let token = HubToken::find(variable)?;
        Self::new(endpoint.as_deref().unwrap_or(ENDPOINT), token, pause)
    }

    /// The name of the user whose token is sent; `None` without a token.
    ///
    /// # Errors
    /// Fails if the Hub does not know the token, or does not answer.
    pub fn user(&self) -> Result<Option<String>, PublishError> {
        if self.http.token.is_none() {
            return Ok(None);
        }
        let call = self.get("asking who the token belongs to", "/api/whoami-v2");
        let response = self.http.expect(&call)?;
        let answer = self.http.json(&call, &response)?;
        let name = answer["name"]
            .as_str()
            .ok_or_else(|| self.http.misread(&call, "no `name`"))?;
        Ok(Some(self.http.safe(name)))
    }

    /// What a dataset repository is; `None` if there is none that the token may see.
    ///
    /// # Errors
    /// Fails if the Hub does not answer, or wants a token.
    pub fn repository(&self, id: &RepositoryId) -> Result<Option<RepositoryInfo>, PublishError> {
        let action = format!("looking at {id}");
        let call = self.get(&action, &format!("/api/datasets/{id}"));
        let response = self.http.send(&call)?;
        if response.status == 404 {
            return Ok(None);
        }
        let answer = self.success(&call, &response)?;
        Ok(Some(RepositoryInfo {
            private: answer["private"].as_bool().unwrap_or_default(),
        }))
    }

    /// The files of a repository at a branch, and its latest commit.
    ///
    /// # Errors
    /// Fails if the Hub does not answer, or lists too many files.
    pub fn tree(&self, id: &RepositoryId, revision: &str) -> Result<RepositoryTree, PublishError> {
        let branch = encoded(revision);
        let action = format!("looking at the files of {id}");
        let call = self.get(&action, &format!("/api/datasets/{id}/revision/{branch}"));
        let response = self.http.send(&call)?;
        if response.status == 404 {
            return Ok(RepositoryTree::default());
        }
        let answer = self.success(&call, &response)?;
        let commit = answer["sha"].as_str().map(str::to_owned);
        let commit = commit.ok_or_else(|| self.http.misread(&call, "no `sha`"))?;
        let mut files = BTreeMap::new();
        let mut next = Some(self.http.url(&format!(
            "/api/datasets/{id}/tree/{}?recursive=true&expand=false&limit=1000",
            encoded(&commit)
        )));
        while let Some(url) = next {
            let call = Call::new(&action, Method::GET, url, Body::Empty);
            let response = self.http.send(&call)?;
            let page = self.success(&call, &response)?;
            let entries = page.as_array();
            let entries = entries.ok_or_else(|| self.http.misread(&call, "no list of files"))?;
            for entry in entries.iter().filter(|entry| entry["type"] == "file") {
                let (path, file) = self.tree_file(&call, entry)?;
                files.insert(path, file);
            }
            if files.len() > TREE_FILES_MAX {
                return Err(self.http.misread(&call, "more than 200,000 files"));
            }
            next = next_page(&response).filter(|url| self.http.is_own(url));
        }
        let commit = Some(commit);
        Ok(RepositoryTree { files, commit })
    }

    fn tree_file(
        &self,
        call: &Call<'_>,
        entry: &Value,
    ) -> Result<(String, ExistingFile), PublishError> {
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let digest = match text(&entry["lfs"]["oid"]) {
            // `sha256:` stands before it in some answers
            Some(oid) => Some(FileDigest::Sha256(
                oid.strip_prefix("sha256:").unwrap_or(&oid).to_owned(),
            )),
            None => text(&entry["oid"]).map(FileDigest::GitBlob),
        };
        let bytes = entry["lfs"]["size"].as_u64().or(entry["size"].as_u64());
        match (text(&entry["path"]), digest, bytes) {
            (Some(path), Some(digest), Some(bytes)) => Ok((path, ExistingFile { bytes, digest })),
            _ => Err(self.http.misread(call, "a file without path, oid or size")),
        }
    }

    /// What the Hub finds wrong with a card, as sentences; `None` if it does not check it.
    ///
    /// # Errors
    /// Fails if the Hub does not answer.
    pub fn validate_card(&self, card: &str) -> Result<Option<Vec<String>>, PublishError> {
        let body = json!({ "content": card, "repoType": "dataset" });
        let url = self.http.url("/api/validate-yaml");
        let action = "asking whether the card is valid";
        let call = Call::new(action, Method::POST, url, Body::Json(&body));
        let response = self.http.send(&call)?;
        if matches!(response.status.as_u16(), 401 | 403 | 404 | 405) {
            return Ok(None);
        }
        let Ok(answer) = self.http.json(&call, &response) else {
            return Err(self.http.refused(&call, &response));
        };
        let Some(errors) = answer["errors"].as_array() else {
            return if response.status.is_success() {
                Ok(Some(Vec::new()))
            } else {
                Err(self.http.refused(&call, &response))
            };
        };
        let sentences = errors.iter().filter_map(|error| error["message"].as_str());
        Ok(Some(sentences.map(|text| self.http.safe(text)).collect()))
    }

    /// Makes a dataset repository; one that is there already is left as it is.
    ///
    /// # Errors
    /// Fails if the token may not make it, or the Hub does not answer.
    pub fn create(&self, id: &RepositoryId, private: bool) -> Result<(), PublishError> {
        let body = json!({
            "type": "dataset", "name": id.name(), "organization": id.owner(),
            "private": private, "visibility": if private { "private" } else { "public" },
        });
        let action = format!("making the repository {id}");
        let url = self.http.url("/api/repos/create");
        let call = Call::new(&action, Method::POST, url, Body::Json(&body));
        let response = self.http.send(&call)?;
        let exists = response.status == 409 && self.repository(id)?.is_some();
        if exists || response.status.is_success() {
            Ok(())
        } else {
            Err(self.http.refused(&call, &response))
        }
    }

    /// Makes a branch that begins at the main branch.
    ///
    /// # Errors
    /// Fails if the token may not make it, or the Hub does not answer.
    pub fn create_branch(&self, id: &RepositoryId, branch: &str) -> Result<(), PublishError> {
        let action = format!("making the branch {branch} of {id}");
        let url = self
            .http
            .url(&format!("/api/datasets/{id}/branch/{}", encoded(branch)));
        let body = json!({});
        let call = Call::new(&action, Method::POST, url, Body::Json(&body));
        let response = self.http.send(&call)?;
        if response.status == 409 || response.status.is_success() {
            Ok(())
        } else {
            Err(self.http.refused(&call, &response))
        }
    }

    fn get<'c>(&self, action: &'c str, route: &str) -> Call<'c> {
        Call::new(action, Method::GET, self.http.url(route), Body::Empty)
    }

    fn success(&self, call: &Call<'_>, response: &Response) -> Result<Value, PublishError> {
        if response.status.is_success() {
            self.http.json(call, response)
        } else {
            Err(self.http.refused(call, response))
        }
    }
}

/// The address of the next page, by the header `Link`.
fn next_page(response: &Response) -> Option<String> {
    let links = response.headers.get("link")?.to_str().ok()?;
    links.split(',').find_map(|link| {
        let (url, relation) = link.trim().strip_prefix('<')?.split_once('>')?;
        relation.contains("rel=\"next\"").then(|| url.to_owned())
    })
}

/// A part of a route: everything but letters, digits and `-_.~` in percent signs.
fn encoded(text: &str) -> String {
    let mut route = String::with_capacity(text.len());
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte) {
            route.push(char::from(byte));
        } else {
            route += &format!("%{byte:02X}");
        }
    }
    route
}

/// Whether a branch can have this name, as Git has it.
pub fn is_branch_name(name: &str) -> bool {
    let is_letter = |c: char| c.is_ascii_alphanumeric() || "-_./".contains(c);
    !name.is_empty()
        && name.len() <= 200
        && name.chars().all(is_letter)
        && !name.contains("..")
        && !name.contains("//")
        && !name.starts_with(['-', '/', '.'])
        && !name.ends_with(['/', '.'])
}
