//! A Hugging Face Hub on this machine, for tests of what is published: repositories of datasets with
//! branches and pull requests, the storage of large files in one piece or in parts, and faults on
//! demand. It refuses what the real one refuses: unknown tokens, commits on top of another state,
//! large files that were never sent, bytes that are not those of their digest.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    sync::{Arc, Mutex, MutexGuard},
    thread,
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};

/// The token that the stub knows.
pub const TOKEN: &str = "stub-token";
/// Files in a page of a tree: few, so that tests turn pages.
const PAGE_FILES: usize = 3;

/// A Hub that is served until the process ends.
#[derive(Clone)]
pub struct StubHub {
    address: String,
    state: Arc<Mutex<HubState>>,
}

/// What the Hub holds.
#[derive(Default)]
pub struct HubState {
    /// The repositories by their names, `owner/name`.
    pub repositories: BTreeMap<String, Repository>,
    /// Large files by their SHA-256.
    pub storage: BTreeMap<String, Vec<u8>>,
    /// Requests as `METHOD /route`, in their order.
    pub requests: Vec<String>,
    /// Answers instead of the real ones: part of a request, status, how often.
    pub faults: Vec<(String, u16, u32)>,
    /// Bytes of a part of a large file; in one piece if it is 0.
    pub part_bytes: usize,
    /// The errors that the Hub finds in every card.
    pub card_errors: Vec<String>,
    parts: BTreeMap<String, BTreeMap<usize, Vec<u8>>>,
    commits: u64,
}

/// A dataset repository with its branches.
#[derive(Clone, Default)]
pub struct Repository {
    /// Whether only its owner sees it.
    pub private: bool,
    /// Branches and pull requests by name.
    pub branches: BTreeMap<String, Branch>,
}

/// A branch: its last commit and its files.
#[derive(Clone, Default)]
pub struct Branch {
    /// The id of the last commit.
    pub commit: String,
    /// The message of the last commit.
    pub message: String,
    /// The files by path: their bytes, and whether they are in the storage of large files.
    pub files: BTreeMap<String, (Vec<u8>, bool)>,
}

/// A request as it came.
struct Request {
    method: String,
    path: String,
    query: String,
    headers: BTreeMap<String, String>,
    body: Vec<u8>,
}

/// Status, further headers, body.
type Reply = (u16, Vec<(String, String)>, Vec<u8>);

impl StubHub {
    /// Starts a Hub without repositories.
    ///
    /// # Panics
    /// Panics if no port is free.
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let hub = Self {
            address,
            state: Arc::default(),
        };
        let served = hub.clone();
        thread::spawn(move || {
            for stream in listener.incoming() {
                let hub = served.clone();
                thread::spawn(move || stream.map(|stream| hub.serve(stream)));
            }
        });
        hub
    }

    /// The value of `HF_ENDPOINT`.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// What the Hub holds now.
    pub fn state(&self) -> MutexGuard<'_, HubState> {
        self.state
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// The files of a branch by path; empty if there is no such branch.
    pub fn files(&self, repository: &str, branch: &str) -> BTreeMap<String, Vec<u8>> {
        let state = self.state();
        let branch = state
            .repositories
            .get(repository)
            .and_then(|it| it.branches.get(branch));
        let files = branch.into_iter().flat_map(|branch| &branch.files);
        files
            .map(|(path, (bytes, _))| (path.clone(), bytes.clone()))
            .collect()
    }

    /// The requests since the last call that begin with this text.
    pub fn take_requests(&self, beginning: &str) -> Vec<String> {
        let requests = std::mem::take(&mut self.state().requests);
        requests
            .into_iter()
            .filter(|request| request.starts_with(beginning))
            .collect()
    }

    fn serve(&self, stream: TcpStream) -> Option<()> {
        let mut stream = BufReader::new(stream);
        let request = read_request(&mut stream)?;
        let (status, headers, body) = self.answer(&request);
        let mut head = format!(
            "HTTP/1.1 {status} X\r\nconnection: close\r\ncontent-length: {}\r\n",
            body.len()
        );
        for (name, value) in headers {
            head += &format!("{name}: {value}\r\n");
        }
        let stream = stream.get_mut();
        write!(stream, "{head}\r\n").ok()?;
        stream.write_all(&body).ok()
    }

    fn answer(&self, request: &Request) -> Reply {
        let line = format!("{} {}", request.method, request.path);
        let mut state = self.state();
        state.requests.push(line.clone());
        let fault = state
            .faults
            .iter_mut()
            .find(|(part, _, count)| *count > 0 && line.contains(part.as_str()));
        if let Some((_, status, count)) = fault {
            *count -= 1;
            return refuse(*status, "a fault of the test");
        }
        if let Some(object) = request.path.strip_prefix("/storage/") {
            return if request.headers.contains_key("authorization") {
                refuse(400, "the token was sent to the storage")
            } else {
                state.store(&request.method, object, &request.body)
            };
        }
        let known = request.headers.get("authorization").map(String::as_str);
        if known.is_some_and(|token| token != format!("Bearer {TOKEN}")) {
            return refuse(401, "Invalid credentials");
        }
        state.route(request, known.is_some(), &self.address)
    }
}

impl HubState {
    fn route(&mut self, request: &Request, signed_in: bool, address: &str) -> Reply {
        let parts: Vec<&str> = request.path.trim_matches('/').split('/').collect();
        let body = || serde_json::from_slice(&request.body).unwrap_or_default();
        if !signed_in && (request.method != "GET" || parts == ["api", "whoami-v2"]) {
            return refuse(401, "Invalid username or password.");
        }
        match (request.method.as_str(), &parts[..]) {
            ("GET", ["api", "whoami-v2"]) => ok(&json!({ "name": "tester", "type": "user" })),
            ("POST", ["api", "validate-yaml"]) => {
                let errors = self.card_errors.iter();
                let errors: Vec<Value> = errors.map(|text| json!({ "message": text })).collect();
                let (status, headers, body) = ok(&json!({ "errors": errors, "warnings": [] }));
                (if errors.is_empty() { status } else { 400 }, headers, body)
            }
            ("POST", ["api", "repos", "create"]) => self.create(&body()),
            ("POST", ["api", "verify"]) => {
                let body: Value = body();
                match self.storage.get(body["oid"].as_str().unwrap_or_default()) {
                    Some(bytes) if body["size"] == bytes.len() => ok(&json!({})),
                    _ => refuse(404, "no such object"),
                }
            }
            ("POST", ["datasets", owner, name, "info", "lfs", "objects", "batch"]) => {
                let name = name.trim_end_matches(".git");
                match self.repositories.contains_key(&format!("{owner}/{name}")) {
                    true => self.batch(&body(), address),
                    false => refuse(404, "Repository not found"),
                }
            }
            (_, ["api", "datasets", owner, name, rest @ ..]) => {
                let id = format!("{owner}/{name}");
                match self.repositories.get(&id) {
                    Some(found) if signed_in || !found.private => {
                        self.repository(&id, request, rest, address)
                    }
                    // as the real one, which tells nobody what is private
                    _ if signed_in => refuse(404, "Repository not found"),
                    _ => refuse(401, "Repository not found"),
                }
            }
            _ => refuse(404, "no such route"),
        }
    }

    fn create(&mut self, body: &Value) -> Reply {
        let text = |key: &str| body[key].as_str().unwrap_or_default().to_owned();
        let id = format!("{}/{}", text("organization"), text("name"));
        if body["type"] != "dataset" || self.repositories.contains_key(&id) {
            return refuse(409, "You already created this dataset repo");
        }
        let attributes = b"*.parquet filter=lfs diff=lfs merge=lfs -text\n".to_vec();
        let branch = Branch {
            commit: self.next_commit(),
            message: "initial commit".to_owned(),
            files: BTreeMap::from([(".gitattributes".to_owned(), (attributes, false))]),
        };
        let repository = Repository {
            private: body["private"] == true,
            branches: BTreeMap::from([("main".to_owned(), branch)]),
        };
        let url = format!("https://huggingface.co/datasets/{id}");
        self.repositories.insert(id, repository);
        ok(&json!({ "url": url }))
    }

    fn next_commit(&mut self) -> String {
        self.commits += 1;
        format!("{:040x}", self.commits)
    }

    fn repository(&mut self, id: &str, request: &Request, rest: &[&str], address: &str) -> Reply {
        let Some(found) = self.repositories.get(id).cloned() else {
            return refuse(404, "Repository not found");
        };
        let decoded = |text: &str| text.replace("%2F", "/");
        match (request.method.as_str(), rest) {
            ("GET", []) => ok(&json!({ "id": id, "private": found.private })),
            ("GET", ["revision", branch]) => match found.branches.get(&decoded(branch)) {
                Some(branch) => ok(&json!({ "id": id, "sha": branch.commit })),
                None => refuse(404, "Invalid rev id"),
            },
            ("GET", ["tree", revision]) => {
                let mut branches = found.branches.iter();
                let named = |(name, it): &(&String, &Branch)| {
                    it.commit == *revision || **name == decoded(revision)
                };
                match branches.find(named) {
                    Some((_, branch)) => tree_page(branch, id, request, address),
                    None => refuse(404, "Invalid rev id"),
                }
            }
            ("POST", ["branch", branch]) => {
                let main = found.branches["main"].clone();
                let found = self.repositories.entry(id.to_owned()).or_default();
                found.branches.insert(decoded(branch), main);
                ok(&json!({}))
            }
            ("POST", ["preupload", branch]) => match found.branches.get(&decoded(branch)) {
                Some(_) => preupload(&serde_json::from_slice(&request.body).unwrap_or_default()),
                None => refuse(404, "Invalid rev id"),
            },
            ("POST", ["commit", branch]) => self.commit(id, &decoded(branch), request),
            _ => refuse(404, "no such route"),
        }
    }

    /// What is to be done for each large file: nothing for those that are there.
    fn batch(&mut self, body: &Value, address: &str) -> Reply {
        let mut objects = Vec::new();
        for object in body["objects"].as_array().into_iter().flatten() {
            let oid = object["oid"].as_str().unwrap_or_default();
            let size = object["size"].as_u64().unwrap_or_default() as usize;
            if self.storage.contains_key(oid) {
                objects.push(json!({ "oid": oid, "size": size }));
                continue;
            }
            let mut header = json!({});
            let mut href = format!("{address}/storage/{oid}?signature=secret");
            if self.part_bytes > 0 && size > self.part_bytes {
                header["chunk_size"] = self.part_bytes.to_string().into();
                for part in 1..=size.div_ceil(self.part_bytes) {
                    header[part.to_string()] = format!("{address}/storage/{oid}/{part}").into();
                }
                href = format!("{address}/storage/{oid}/complete");
            }
            let verify = json!({ "href": format!("{address}/api/verify"), "header": {} });
            objects.push(json!({
                "oid": oid, "size": size,
                "actions": { "upload": { "href": href, "header": header }, "verify": verify },
            }));
        }
        ok(&json!({ "transfer": "basic", "objects": objects }))
    }

    fn store(&mut self, method: &str, object: &str, body: &[u8]) -> Reply {
        let (oid, part) = object.split_once('/').unwrap_or((object, ""));
        if let Ok(number) = part.parse() {
            let parts = self.parts.entry(oid.to_owned()).or_default();
            parts.insert(number, body.to_vec());
            let etag = format!("\"{number}\"");
            return (200, vec![("etag".to_owned(), etag)], Vec::new());
        }
        let bytes = if part == "complete" {
            let answered: Value = serde_json::from_slice(body).unwrap_or_default();
            let parts = self.parts.remove(oid).unwrap_or_default();
            let count = answered["parts"].as_array().map_or(0, Vec::len);
            if method != "POST" || count != parts.len() {
                return refuse(400, "parts are missing");
            }
            parts.into_values().flatten().collect()
        } else {
            body.to_vec()
        };
        if sha256(&bytes) != oid {
            return refuse(400, "the bytes are not those of the digest");
        }
        self.storage.insert(oid.to_owned(), bytes);
        ok(&json!({}))
    }

    fn commit(&mut self, id: &str, branch: &str, request: &Request) -> Reply {
        let text = String::from_utf8_lossy(&request.body);
        let lines: Vec<Value> = text
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_default())
            .collect();
        let Some(found) = self.repositories.get(id) else {
            return refuse(404, "Repository not found");
        };
        let Some(mut next) = found.branches.get(branch).cloned() else {
            return refuse(404, "Invalid rev id");
        };
        for line in &lines {
            let value = &line["value"];
            let path = value["path"].as_str().unwrap_or_default().to_owned();
            match line["key"].as_str().unwrap_or_default() {
                "header"
                    if value["parentCommit"].is_string()
                        && value["parentCommit"] != next.commit.as_str() =>
                {
                    return refuse(412, "A commit has happened since");
                }
                "header" => next.message = value["summary"].as_str().unwrap_or_default().into(),
                "file" => {
                    let content = value["content"].as_str().unwrap_or_default();
                    let bytes = STANDARD.decode(content).unwrap_or_default();
                    next.files.insert(path, (bytes, false));
                }
                "lfsFile" => {
                    let oid = value["oid"].as_str().unwrap_or_default();
                    let Some(bytes) = self.storage.get(oid) else {
                        return refuse(400, "a large file was not sent");
                    };
                    next.files.insert(path, (bytes.clone(), true));
                }
                "deletedFile" => drop(next.files.remove(&path)),
                _ => return refuse(400, "an unknown line"),
            }
        }
        next.commit = self.next_commit();
        let mut answer = json!({
            "success": true, "commitOid": next.commit, "commitUrl": format!("https://huggingface.co/{id}/commit/{}", next.commit),
        });
        let mut branch = branch.to_owned();
        let found = self.repositories.entry(id.to_owned()).or_default();
        if request.query.contains("create_pr=1") {
            let count = found.branches.keys();
            let number = 1 + count.filter(|name| name.starts_with("refs/pr/")).count();
            answer["pullRequestUrl"] =
                format!("https://huggingface.co/datasets/{id}/discussions/{number}").into();
            branch = format!("refs/pr/{number}");
        }
        found.branches.insert(branch, next);
        ok(&answer)
    }
}

/// Small files by their ending, large ones else.
fn preupload(body: &Value) -> Reply {
    let files = body["files"].as_array().into_iter().flatten();
    let modes: Vec<Value> = files
        .map(|file| {
            let path = file["path"].as_str().unwrap_or_default();
            let is_text = [".md", ".json", ".gitattributes", "SHA256SUMS"]
                .iter()
                .any(|ending| path.ends_with(ending));
            let mode = if is_text { "regular" } else { "lfs" };
            json!({ "path": path, "uploadMode": mode, "shouldIgnore": false })
        })
        .collect();
    ok(&json!({ "files": modes }))
}

fn tree_page(branch: &Branch, id: &str, request: &Request, address: &str) -> Reply {
    let mut pairs = request.query.split('&');
    let from = pairs.find_map(|pair| pair.strip_prefix("cursor=")?.parse().ok());
    let from = from.unwrap_or(0);
    let entries = branch.files.iter().skip(from).take(PAGE_FILES);
    let entries: Vec<Value> = entries
        .map(|(path, (bytes, is_large))| {
            let oid = git_blob(bytes);
            let mut entry =
                json!({ "type": "file", "path": path, "size": bytes.len(), "oid": oid });
            if *is_large {
                let oid = sha256(bytes);
                entry["lfs"] = json!({ "oid": oid, "size": bytes.len(), "pointerSize": 130 });
            }
            entry
        })
        .collect();
    let (status, mut headers, body) = ok(&entries.into());
    if from + PAGE_FILES < branch.files.len() {
        let next = from + PAGE_FILES;
        let url = format!(
            "{address}/api/datasets/{id}/tree/{}?cursor={next}",
            branch.commit
        );
        headers.push(("link".to_owned(), format!("<{url}>; rel=\"next\"")));
    }
    (status, headers, body)
}

fn ok(body: &Value) -> Reply {
    (200, Vec::new(), body.to_string().into_bytes())
}

fn refuse(status: u16, reason: &str) -> Reply {
    let body = json!({ "error": reason });
    (status, Vec::new(), body.to_string().into_bytes())
}

fn sha256(bytes: &[u8]) -> String {
    hex(&<sha2::Sha256 as sha2::Digest>::digest(bytes))
}

/// The id that Git gives a file.
fn git_blob(bytes: &[u8]) -> String {
    let head = format!("blob {}\0", bytes.len());
    hex(&<sha1::Sha1 as sha1::Digest>::digest(
        [head.as_bytes(), bytes].concat(),
    ))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn read_request(stream: &mut BufReader<TcpStream>) -> Option<Request> {
    let mut line = String::new();
    stream.read_line(&mut line).ok()?;
    let mut words = line.split_whitespace();
    let (method, target) = (words.next()?.to_owned(), words.next()?.to_owned());
    let (path, query) = target.split_once('?').unwrap_or((&target, ""));
    let mut headers = BTreeMap::new();
    loop {
        let mut line = String::new();
        if stream.read_line(&mut line).ok()? <= 2 {
            break;
        }
        let (name, value) = line.split_once(':')?;
        headers.insert(name.to_lowercase(), value.trim().to_owned());
    }
    if headers.get("expect").is_some_and(|it| it.contains("100")) {
        stream
            .get_mut()
            .write_all(b"HTTP/1.1 100 Continue\r\n\r\n")
            .ok()?;
    }
    let length = headers.get("content-length");
    let length: usize = length.map_or(Some(0), |length| length.parse().ok())?;
    if headers.contains_key("transfer-encoding") {
        // the storage of the real one takes no chunks either
        return None;
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).ok()?;
    Some(Request {
        method,
        path: path.to_owned(),
        query: query.to_owned(),
        headers,
        body,
    })
}
