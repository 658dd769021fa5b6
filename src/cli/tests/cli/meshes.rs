//! An episode with meshes through everything that executes traces: blame, SQL, exports, the service.

use std::{
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
};

use crate::{complaint, expect, first_trace, usd_meshes::assets};

/// A tetrahedron of one unit.
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

/// A failed and a good episode whose objects are all meshes of the folder `meshes`.
fn episodes(folder: &Path) {
    reel!(
        folder,
        "task draw --count 1 --families FDP --seed 4 --out tasks"
    );
    fs::create_dir(folder.join("meshes")).unwrap();
    let listed = reel!(folder, "run --tasks tasks --out bare --no-images --json");
    assert!(listed.contains("success"), "{listed}");
    for asset in assets(folder) {
        fs::write(folder.join(format!("meshes/{asset}.obj")), OBJ).unwrap();
    }
    for policy in ["oracle", "wrong-object"] {
        reel!(
            folder,
            "run --tasks tasks --policy {policy} --assets meshes --out traces --no-images"
        );
    }
}

#[test]
fn what_executes_traces_takes_their_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    episodes(folder);
    assert!(
        expect(folder, 1, "replay traces").contains("REFUSED"),
        "without meshes"
    );
    assert!(reel!(folder, "replay traces --assets meshes").starts_with("2 of 2"));
    let refused = complaint(folder, 1, "blame traces");
    assert!(refused.contains("are meshes"), "{refused}");
    let blamed = reel!(
        folder,
        "blame traces --assets meshes --branches better --json"
    );
    let verified = blamed.lines().any(|line| {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        line["alternative"]["verified"] == true
    });
    assert!(verified, "{blamed}");

    reel!(folder, "ingest traces --assets meshes --store store");
    let verdicts = |assets: &str| {
        let query = "SELECT replay(trace).verdict AS verdict FROM episodes";
        let command = format!("query --store store {assets} --format csv | {query}");
        expect(folder, 0, &command)
    };
    assert_eq!(
        verdicts("--assets meshes").matches("exact").count(),
        2,
        "{}",
        verdicts("--assets meshes")
    );
    assert_eq!(verdicts("").matches("exact").count(), 0);
    let branch = "SELECT blame(trace).cause AS cause FROM episodes WHERE NOT success";
    let command = format!("query --store store --assets meshes --format csv | {branch}");
    assert!(expect(folder, 0, &command).lines().count() > 1);

    let exported = reel!(
        folder,
        "export sft --store store --assets meshes --out sft --json"
    );
    assert!(folder.join("sft").is_dir(), "{exported}");
    let pairs = reel!(
        folder,
        "export preferences --store store --assets meshes --out pairs --json"
    );
    let pairs: serde_json::Value = serde_json::from_str(&pairs).unwrap();
    assert!(pairs["pairs"].as_u64().unwrap() > 0, "{pairs}");
    reel!(folder, "export coco traces --assets meshes --out coco");
}

/// A server that ends with the test.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The answer to a request, head and body.
fn request(address: &str, request: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "{request}").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn the_service_executes_traces_with_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    episodes(folder);
    fs::create_dir_all(folder.join("data")).unwrap();
    fs::rename(folder.join("traces"), folder.join("data/traces")).unwrap();
    fs::create_dir(folder.join("traces")).unwrap();
    for entry in fs::read_dir(folder.join("data/traces")).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, folder.join("traces").join(path.file_name().unwrap())).unwrap();
    }
    let trace = first_trace(folder);
    let name = trace.file_stem().unwrap().to_str().unwrap().to_owned();
    let child = Command::new(env!("CARGO_BIN_EXE_reel"))
        .current_dir(folder)
        .args(["serve", "--listen", "127.0.0.1:0", "--data", "data"])
        .args(["--tasks", "tasks", "--assets", "meshes"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut server = Server(child);
    let mut line = String::new();
    let out = server.0.stdout.take().unwrap();
    BufReader::new(out).read_line(&mut line).unwrap();
    let address = line
        .split("http://")
        .nth(1)
        .and_then(|rest| rest.split(": ").next())
        .unwrap_or_else(|| panic!("no address in {line:?}"))
        .to_owned();
    let get = |path: &str| {
        request(
            &address,
            &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n"),
        )
    };
    let post = format!(
        "POST /api/traces/{name}/replay HTTP/1.1\r\nHost: {address}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    );
    let replayed = request(&address, &post);
    assert!(replayed.contains("exact"), "{replayed}");
    let frame = get(&format!("/api/traces/{name}/frames/1"));
    assert!(frame.starts_with("HTTP/1.1 200"), "{frame:.300}");
}
