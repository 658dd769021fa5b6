//! Large files: the storage behind Git LFS is asked which objects it lacks, and gets those in one
//! piece or in parts (https://github.com/git-lfs/git-lfs/blob/main/docs/api/batch.md). Objects that
//! arrived before are not sent again.

use std::{
    collections::BTreeMap,
    io::{Read, Seek as _, SeekFrom},
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use reel_http::ureq::http::Method;
use serde_json::{Value, json};

use super::{Body, Call, Hub};
use crate::{PublishError, PublishedFile, RepositoryId, folder::Content};

/// The media type of the protocol.
const MEDIA_TYPE: &str = "application/vnd.git-lfs+json";
/// Objects that are asked for at a time.
const BATCH_OBJECTS: usize = 256;
/// Most parts of one object.
const PARTS_MAX: usize = 10_000;
/// Objects that are sent at a time.
const UPLOADS_AT_A_TIME: usize = 4;

/// How often the bytes of objects were sent, and how many bytes.
pub(super) type Progress<'p> = &'p (dyn Fn(u64) + Sync);

impl Hub {
    /// Brings these files into the storage of large files; those that it has are left out.
    pub(super) fn send_large(
        &self,
        id: &RepositoryId,
        branch: &str,
        files: &[&PublishedFile],
        sent: Progress<'_>,
    ) -> Result<(), PublishError> {
        // equal files are one object
        let objects: BTreeMap<&str, &PublishedFile> = files
            .iter()
            .map(|file| (file.sha256.as_str(), *file))
            .collect();
        let objects: Vec<(&str, &PublishedFile)> = objects.into_iter().collect();
        for batch in objects.chunks(BATCH_OBJECTS) {
            let wanted = self.wanted(id, branch, batch)?;
            self.send_all(&wanted, sent)?;
        }
        Ok(())
    }

    /// The objects that the storage lacks, with what it says about each.
    fn wanted<'f>(
        &self,
        id: &RepositoryId,
        branch: &str,
        batch: &[(&str, &'f PublishedFile)],
    ) -> Result<Vec<(&'f PublishedFile, Value)>, PublishError> {
        let listed = batch.iter();
        let listed = listed.map(|(oid, file)| json!({ "oid": oid, "size": file.bytes }));
        let body = json!({
            "operation": "upload", "transfers": ["basic", "multipart"], "hash_algo": "sha256",
            "ref": { "name": branch }, "objects": listed.collect::<Vec<Value>>(),
        })
        .to_string();
        let url = self
            .http
            .url(&format!("/datasets/{id}.git/info/lfs/objects/batch"));
        let action = format!("asking {id} for large files that it lacks");
        let body = Body::Bytes(MEDIA_TYPE, body.as_bytes());
        let mut call = Call::new(&action, Method::POST, url, body);
        call.headers.push(("accept".into(), MEDIA_TYPE.into()));
        let response = self.http.expect(&call)?;
        let answer = self.http.json(&call, &response)?;
        let objects = answer["objects"].as_array();
        let objects = objects.ok_or_else(|| self.http.misread(&call, "no `objects`"))?;
        let files: BTreeMap<&str, &'f PublishedFile> = batch.iter().copied().collect();
        let mut wanted = Vec::new();
        for object in objects {
            let oid = object["oid"].as_str().unwrap_or_default();
            let file = files.get(oid).copied();
            let file = file.ok_or_else(|| self.http.misread(&call, "an unknown object"))?;
            if let Some(error) = object["error"]["message"].as_str() {
                let reason = format!("{}: {}", file.path, self.http.safe(error));
                return Err(PublishError::Repository {
                    repository: id.to_string(),
                    reason,
                });
            }
            if object["actions"]["upload"].is_object() {
                wanted.push((file, object["actions"].clone()));
            }
        }
        if objects.len() < batch.len() {
            return Err(self.http.misread(&call, "objects are missing"));
        }
        Ok(wanted)
    }

    /// Sends objects, some at a time; the first error ends it.
    fn send_all(
        &self,
        wanted: &[(&PublishedFile, Value)],
        sent: Progress<'_>,
    ) -> Result<(), PublishError> {
        let next = AtomicUsize::new(0);
        let failure: Mutex<Option<PublishError>> = Mutex::new(None);
        let work = || {
            while let Some((file, actions)) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
                match self.send_object(file, actions) {
                    Ok(()) => sent(file.bytes),
                    Err(error) => {
                        // no further object is begun
                        next.store(wanted.len(), Ordering::Relaxed);
                        if let Ok(mut failure) = failure.lock() {
                            failure.get_or_insert(error);
                        }
                    }
                }
            }
        };
        thread::scope(|scope| {
            for _ in 0..UPLOADS_AT_A_TIME.min(wanted.len()) {
                scope.spawn(work);
            }
        });
        match failure.into_inner() {
            Ok(None) => Ok(()),
            Ok(Some(error)) => Err(error),
            Err(poisoned) => poisoned.into_inner().map_or(Ok(()), Err),
        }
    }

    fn send_object(&self, file: &PublishedFile, actions: &Value) -> Result<(), PublishError> {
        let action = format!("sending {}", file.path);
        let upload = &actions["upload"];
        let url = self.storage_url(&action, upload)?;
        let header = upload["header"].as_object();
        let chunk = header.and_then(|header| header.get("chunk_size"));
        match chunk {
            Some(chunk) => {
                let chunk = chunk.as_u64().or_else(|| chunk.as_str()?.parse().ok());
                self.send_parts(&action, file, upload, chunk.unwrap_or_default(), &url)?;
            }
            None => {
                let open = || file.open();
                let mut call =
                    Call::new(&action, Method::PUT, url, Body::Stream(file.bytes, &open));
                call.authorized = false;
                for (name, value) in header.into_iter().flatten() {
                    if let Some(value) = value.as_str() {
                        call.headers.push((name.clone(), value.to_owned()));
                    }
                }
                self.http.expect(&call)?;
            }
        }
        if !actions["verify"].is_object() {
            return Ok(());
        }
        let url = self.storage_url(&action, &actions["verify"])?;
        let body = json!({ "oid": file.sha256, "size": file.bytes });
        let authorized = self.http.is_own(&url);
        let mut call = Call::new(&action, Method::POST, url, Body::Json(&body));
        call.authorized = authorized;
        self.http.expect(&call).map(drop)
    }

    /// Sends an object in parts, each to its own address, and then what each was answered.
    fn send_parts(
        &self,
        action: &str,
        file: &PublishedFile,
        upload: &Value,
        chunk: u64,
        complete: &str,
    ) -> Result<(), PublishError> {
        let mut urls: BTreeMap<usize, &Value> = BTreeMap::new();
        for (name, url) in upload["header"].as_object().into_iter().flatten() {
            if let Ok(number) = name.parse::<usize>() {
                urls.insert(number, url);
            }
        }
        let call = Call::new(action, Method::POST, complete.to_owned(), Body::Empty);
        let parts = file
            .bytes
            .checked_div(chunk)
            .map(|_| file.bytes.div_ceil(chunk));
        if parts != Some(urls.len() as u64) || urls.len() > PARTS_MAX {
            return Err(self.http.misread(&call, "parts that do not fit the file"));
        }
        let mut answered = Vec::new();
        for (index, (number, url)) in urls.into_iter().enumerate() {
            let from = index as u64 * chunk;
            let length = chunk.min(file.bytes - from);
            let open = || part(file, from, length);
            let url = self.storage_url(action, &json!({ "href": url }))?;
            let mut put = Call::new(action, Method::PUT, url, Body::Stream(length, &open));
            put.authorized = false;
            let response = self.http.expect(&put)?;
            let etag = response.headers.get("etag").and_then(|it| it.to_str().ok());
            let etag = etag.ok_or_else(|| self.http.misread(&put, "no `etag` of a part"))?;
            answered.push(json!({ "partNumber": number, "etag": etag }));
        }
        let body = json!({ "oid": file.sha256, "parts": answered }).to_string();
        let body = Body::Bytes(MEDIA_TYPE, body.as_bytes());
        let mut call = Call::new(action, Method::POST, complete.to_owned(), body);
        call.headers.push(("accept".into(), MEDIA_TYPE.into()));
        // its address is signed, as those of the parts are
        call.authorized = false;
        self.http.expect(&call).map(drop)
    }

    /// The address of an action. Files that go to a Hub over TLS go nowhere in clear.
    fn storage_url(&self, action: &str, of: &Value) -> Result<String, PublishError> {
        let url = of["href"].as_str().unwrap_or_default();
        let secure = self.http.endpoint.starts_with("https://");
        if url.starts_with("https://") || (!secure && url.starts_with("http://")) {
            return Ok(url.to_owned());
        }
        let call = Call::new(action, Method::PUT, url.to_owned(), Body::Empty);
        Err(self.http.misread(&call, "no address to send a file to"))
    }
}

/// The bytes of a part of a file.
fn part(
    file: &PublishedFile,
    from: u64,
    length: u64,
) -> Result<Box<dyn Read + Send + '_>, PublishError> {
    match &file.content {
        Content::Memory(bytes) => {
            let rest = bytes.get(usize::try_from(from).unwrap_or(usize::MAX)..);
            Ok(Box::new(rest.unwrap_or_default().take(length)))
        }
        Content::Disk(path) => {
            let mut opened = std::fs::File::open(path).map_err(PublishError::read(path))?;
            opened
                .seek(SeekFrom::Start(from))
                .map_err(PublishError::read(path))?;
            Ok(Box::new(opened.take(length)))
        }
    }
}
