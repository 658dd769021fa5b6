//! A plan as commits: the Hub says which files are large, those go to its storage, and a commit
//! names them beside the small ones. What says that the dataset is whole comes last, and a commit
//! on top of another state than the compared one is refused.

use std::{collections::BTreeMap, io::Read as _};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use reel_http::ureq::http::Method;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use super::{Body, Call, Hub, RepositoryTree, encoded, lfs::Progress};
use crate::{
    Plan, Publication, PublishError, PublishedFile, RepositoryId, folder::hex,
    generated::GIT_ATTRIBUTES,
};

/// Most files of a commit, and of a question about files.
const COMMIT_FILES: usize = 256;
/// Most bytes of small files in a commit.
const COMMIT_BYTES: u64 = 16 << 20;
/// Bytes of a file by which the Hub tells text from other files.
const SAMPLE_BYTES: u64 = 512;

/// How a dataset is committed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CommitOptions {
    /// The branch that is written to, or that a pull request is made for.
    pub branch: String,
    /// The first line of the commit's message.
    pub message: String,
    /// Whether to propose the change as a pull request.
    pub create_pr: bool,
    /// Whether to delete files that only the repository has.
    pub delete: bool,
}

/// What came of the commits.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct PublishedCommit {
    /// The last commit; `None` if there was nothing to commit.
    pub commit: Option<String>,
    /// Where people see it, as the Hub says.
    pub url: Option<String>,
    /// Number of commits that were made.
    pub commits: u64,
}

/// A branch with the commit that the next one is made on.
struct Head {
    branch: String,
    commit: Option<String>,
    create_pr: bool,
}

impl Hub {
    /// Sends what is new or changed, and commits it; `sent` is told the bytes of each file that
    /// was sent.
    ///
    /// # Errors
    /// Fails if the Hub refuses something, or a file changed since it was checked. What was sent
    /// stays: the next call sends the rest.
    pub fn publish(
        &self,
        id: &RepositoryId,
        publication: &Publication,
        (plan, tree): (&Plan, &RepositoryTree),
        options: &CommitOptions,
        sent: &(dyn Fn(u64) + Sync),
    ) -> Result<PublishedCommit, PublishError> {
        let files: Vec<&PublishedFile> = plan
            .to_write()
            .filter_map(|planned| publication.files().get(&planned.path))
            .collect();
        let mut head = Head {
            branch: options.branch.clone(),
            commit: tree.commit.clone(),
            create_pr: options.create_pr,
        };
        let deleted: &[String] = if options.delete {
            &plan.only_at_target
        } else {
            &[]
        };
        let mut done = PublishedCommit::default();
        let mut rest = &files[..];
        while !rest.is_empty() || (!deleted.is_empty() && done.commits == 0) {
            let next = &rest[..rest.len().min(COMMIT_FILES)];
            let (modes, count) = self.storage(id, &head, publication, next)?;
            let some;
            (some, rest) = rest.split_at(count);
            let large: Vec<&PublishedFile> = some
                .iter()
                .copied()
                .filter(|file| modes[file.path.as_str()])
                .collect();
            self.send_large(id, &head.branch, &large, sent as Progress<'_>)?;
            let mut lines = vec![header(options, &head, done.commits)];
            for file in some {
                lines.push(commit_line(file, modes[file.path.as_str()])?);
            }
            if rest.is_empty() {
                let deleted = deleted.iter();
                lines.extend(
                    deleted.map(|path| json!({ "key": "deletedFile", "value": { "path": path } })),
                );
            }
            self.commit(id, &mut head, &lines, &mut done)?;
        }
        Ok(done)
    }

    /// Whether each file is large, as the Hub has it, and how many of them fit into one commit.
    fn storage<'f>(
        &self,
        id: &RepositoryId,
        head: &Head,
        publication: &Publication,
        files: &[&'f PublishedFile],
    ) -> Result<(BTreeMap<&'f str, bool>, usize), PublishError> {
        if files.is_empty() {
            return Ok((BTreeMap::new(), 0));
        }
        let mut listed = Vec::new();
        for file in files {
            let mut sample = Vec::new();
            let read = file.open()?.take(SAMPLE_BYTES).read_to_end(&mut sample);
            read.map_err(PublishError::read(&file.place()))?;
            listed.push(json!({
                "path": file.path, "size": file.bytes, "sample": STANDARD.encode(sample),
            }));
        }
        let mut body = json!({ "files": listed });
        if let Some(attributes) = publication.files().get(GIT_ATTRIBUTES) {
            body["gitAttributes"] = small_text(attributes)?.into();
        }
        let action = format!("asking how {id} stores the files");
        let route = format!("/api/datasets/{id}/preupload/{}", encoded(&head.branch));
        let url = self.http.url(&(route + head.query()));
        let call = Call::new(&action, Method::POST, url, Body::Json(&body));
        let response = self.http.expect(&call)?;
        let answer = self.http.json(&call, &response)?;
        let mut modes = BTreeMap::new();
        for entry in answer["files"].as_array().into_iter().flatten() {
            let file = files
                .iter()
                .find(|file| entry["path"] == file.path.as_str());
            let file = file.ok_or_else(|| self.http.misread(&call, "an unknown file"))?;
            if entry["shouldIgnore"] == true {
                return Err(PublishError::Repository {
                    repository: id.to_string(),
                    reason: format!(
                        "the repository's .gitignore leaves out {}; change it there first",
                        file.path
                    ),
                });
            }
            modes.insert(file.path.as_str(), entry["uploadMode"] == "lfs");
        }
        let (mut count, mut bytes) = (0, 0);
        for file in files {
            match modes.get(file.path.as_str()) {
                None => return Err(self.http.misread(&call, "a file is missing")),
                Some(true) => {}
                Some(false) if file.bytes > COMMIT_BYTES => {
                    return Err(self
                        .http
                        .misread(&call, "a large file shall be no large file"));
                }
                Some(false) => bytes += file.bytes,
            }
            if bytes > COMMIT_BYTES {
                break;
            }
            count += 1;
        }
        Ok((modes, count))
    }

    fn commit(
        &self,
        id: &RepositoryId,
        head: &mut Head,
        lines: &[Value],
        done: &mut PublishedCommit,
    ) -> Result<(), PublishError> {
        let body: String = lines.iter().map(|line| format!("{line}\n")).collect();
        let action = format!("committing to {id}");
        let route = format!("/api/datasets/{id}/commit/{}", encoded(&head.branch));
        let url = self.http.url(&(route + head.query()));
        let body = Body::Bytes("application/x-ndjson", body.as_bytes());
        let mut call = Call::new(&action, Method::POST, url, body);
        call.repeatable = false;
        let response = self.http.expect(&call)?;
        let answer = self.http.json(&call, &response)?;
        let text = |key: &str| answer[key].as_str().map(|text| self.http.safe(text));
        let commit = text("commitOid");
        let commit = commit.ok_or_else(|| self.http.misread(&call, "no `commitOid`"))?;
        head.commit = Some(commit.clone());
        if head.create_pr {
            // the next commits go to the pull request
            let reference = answer["pullRequestUrl"]
                .as_str()
                .and_then(|url| url.rsplit('/').next()?.parse::<u64>().ok());
            let number =
                reference.ok_or_else(|| self.http.misread(&call, "no number of a pull request"))?;
            head.branch = format!("refs/pr/{number}");
            head.create_pr = false;
        }
        done.url = text("pullRequestUrl")
            .or(done.url.take())
            .or(text("commitUrl"));
        done.commit = Some(commit);
        done.commits += 1;
        Ok(())
    }
}

impl Head {
    fn query(&self) -> &'static str {
        if self.create_pr { "?create_pr=1" } else { "" }
    }
}

fn header(options: &CommitOptions, head: &Head, number: u64) -> Value {
    let summary = match number {
        0 => options.message.clone(),
        _ => format!("{} (part {})", options.message, number + 1),
    };
    let mut value = json!({ "summary": summary, "description": "" });
    if let Some(commit) = &head.commit {
        value["parentCommit"] = commit.as_str().into();
    }
    json!({ "key": "header", "value": value })
}

/// A file in a commit: by its digest if it is large, else with its bytes, which are checked.
fn commit_line(file: &PublishedFile, is_large: bool) -> Result<Value, PublishError> {
    if is_large {
        return Ok(json!({
            "key": "lfsFile",
            "value": { "path": file.path, "algo": "sha256", "oid": file.sha256, "size": file.bytes },
        }));
    }
    let content = STANDARD.encode(small_bytes(file)?);
    Ok(json!({
        "key": "file", "value": { "path": file.path, "encoding": "base64", "content": content },
    }))
}

fn small_bytes(file: &PublishedFile) -> Result<Vec<u8>, PublishError> {
    let mut bytes = Vec::new();
    let read = file.open()?.take(COMMIT_BYTES + 1).read_to_end(&mut bytes);
    read.map_err(PublishError::read(&file.place()))?;
    if hex(&Sha256::digest(&bytes)) == file.sha256 {
        Ok(bytes)
    } else {
        Err(PublishError::Changed { path: file.place() })
    }
}

fn small_text(file: &PublishedFile) -> Result<String, PublishError> {
    let bytes = small_bytes(file)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
