//! The blocks of one page, executed in one temporary folder.

use std::{
    collections::BTreeMap,
    env, fs,
    net::{SocketAddr, TcpListener, TcpStream},
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::OnceLock,
    thread,
    time::{Duration, Instant},
};

use tempfile::TempDir;

use crate::{
    page::{Block, Note, Page},
    root,
};

/// Programs that pages name and that the test does not run: others wrote them.
const NOT_OURS: &[&str] = &[
    "accelerate",
    "alias",
    "bash",
    "git",
    "llamafactory-cli",
    "pip",
    "python",
    "strace",
    "swift",
];

/// Programs of every Unix that commands of pages use beside `reel`.
const SHELL: &[&str] = &[
    "cat", "cd", "cp", "curl", "echo", "export", "head", "ls", "mkdir", "mv", "printf", "reel",
    "rm", "sleep",
];

/// Commands that run until Ctrl-C, with the port that they listen on unless told otherwise.
const SERVERS: &[(&str, Option<u16>)] = &[
    ("reel serve", Some(8801)),
    ("reel agent mock-llm", Some(8000)),
    ("reel record --upstream", Some(8810)),
    ("reel cluster scheduler", None),
    ("reel cluster executor", None),
];

/// How long a server may take until it listens, or ends.
const PATIENCE: Duration = Duration::from_secs(30);

/// Commands slower than this are printed.
const SLOW: Duration = Duration::from_secs(5);

/// The folder that `reel demo` filled with less than its 210 episodes, shared by all pages; they
/// get copies.
fn demo() -> &'static Path {
    static DEMO: OnceLock<TempDir> = OnceLock::new();
    let folder = DEMO.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let status = Command::new(env!("CARGO_BIN_EXE_reel"))
            .args(["demo", "--out", "demo-out", "--count", "4"])
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        assert!(status.unwrap().success(), "reel demo failed");
        folder
    });
    folder.path()
}

/// A page while its blocks are executed, and what came of them.
pub struct Session<'a> {
    page: &'a Page,
    /// Reads the blocks in Python.
    python: Option<&'a Path>,
    folder: TempDir,
    /// Holds `reel` under its name, the variables and the working folder between commands.
    state: TempDir,
    /// Ports that the page names, and free ones that stand for them.
    ports: BTreeMap<u16, u16>,
    servers: Vec<Server>,
    /// How many commands ran.
    pub run: usize,
    /// Commands and blocks that were parsed by what reads them.
    pub parsed: usize,
    /// Commands of other programs.
    pub foreign: Vec<String>,
    /// What did not work, with its line.
    pub failures: Vec<String>,
}

impl<'a> Session<'a> {
    /// An empty folder for a page.
    pub fn new(page: &'a Page, python: Option<&'a Path>) -> Self {
        let state = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_reel"), state.path().join("reel")).unwrap();
        fs::write(
            state.path().join(".curlrc"),
            "fail-with-body\nno-progress-meter\n",
        )
        .unwrap();
        Self {
            page,
            python,
            folder: tempfile::tempdir().unwrap(),
            state,
            ports: BTreeMap::new(),
            servers: Vec::new(),
            run: 0,
            parsed: 0,
            foreign: Vec::new(),
            failures: Vec::new(),
        }
    }

    /// Executes the blocks, one after the other, and stops the servers that they started.
    pub fn play(&mut self) {
        let page = self.page;
        for block in &page.blocks {
            for name in ["env", "cwd"] {
                let _ = fs::remove_file(self.state.path().join(name));
            }
            if let Err(failure) = self.block(block) {
                let place = format!("{}:{}", page.path, block.line);
                self.failures.push(format!("{place}: {failure}"));
            }
        }
        for server in self.servers.drain(..) {
            self.failures.extend(server.stop());
        }
    }

    fn block(&mut self, block: &Block) -> Result<(), String> {
        for note in &block.notes {
            match note {
                Note::File(name) => fs::write(self.folder.path().join(name), &block.text)
                    .map_err(|error| format!("{name}: {error}"))?,
                Note::ReadBy(command) => {
                    let file = format!("block-{}", block.line);
                    fs::write(self.folder.path().join(&file), &block.text)
                        .map_err(|error| error.to_string())?;
                    let output = self.bash(&command.replace("{}", &file), false);
                    succeeded(command, 0, &output)?;
                    self.parsed += 1;
                }
                Note::ParseOnly { .. } => {}
            }
        }
        let is_read = block
            .notes
            .iter()
            .any(|note| !matches!(note, Note::ParseOnly { .. }));
        match block.language.as_str() {
            "setup" | "sh" | "console" => {
                for command in commands(block) {
                    if let Err(failure) = self.command(block, &command) {
                        let place = format!("{}:{}", self.page.path, command.line);
                        self.failures.push(format!("{place}: {failure}"));
                    }
                }
                Ok(())
            }
            "sql" if !is_read => {
                let output = self.output(Command::new(env!("CARGO_BIN_EXE_reel")).args([
                    "query",
                    "--store",
                    "store",
                    &block.text,
                ]));
                self.run += 1;
                succeeded("reel query", 0, &output)
            }
            "json" => {
                self.parsed += usize::from(!is_read);
                serde_json::from_str::<serde_json::Value>(&block.text)
                    .map(|_| ())
                    .map_err(|error| error.to_string())
            }
            "python" => self.python(block),
            "toml" | "sql" | "xml" if is_read => Ok(()),
            "toml" => Err("say which command reads it: `test: file` or `test: read by`".to_owned()),
            "yaml" => {
                let steps = block.text.lines();
                let commands = steps.filter_map(|line| line.trim_start().strip_prefix("- run: "));
                self.block(&Block {
                    line: block.line,
                    language: "sh".to_owned(),
                    text: commands.collect::<Vec<_>>().join("\n"),
                    notes: block.notes.clone(),
                })
            }
            // tests/web/guide.mjs compiles them
            "ts" => Ok(()),
            "text" | "nginx" | "mermaid" => Ok(()),
            other => Err(format!("what is a block in '{other}'?")),
        }
    }

    fn command(&mut self, block: &Block, command: &Typed) -> Result<(), String> {
        let scan = Scan::of(&command.text);
        let mut segments = scan.segments.iter();
        if let Some(words) = segments.clone().find(|it| is_checked(&it[0])) {
            self.parsed += 1;
            return checked(words);
        }
        if let Some(words) = segments
            .clone()
            .find(|it| NOT_OURS.contains(&it[0].as_str()))
        {
            let place = format!("{}:{}", self.page.path, command.line);
            self.foreign.push(format!("{place}: {}", words[0]));
            return Ok(());
        }
        if let Some(words) = segments.find(|it| !SHELL.contains(&it[0].as_str())) {
            let lists = "neither reel nor one of the lists of shell.rs";
            return Err(format!("`{}`: {lists}", words[0]));
        }
        let parse_only = block.notes.iter().any(|note| {
            matches!(note, Note::ParseOnly { words } if command.text.contains(words.as_str()))
        });
        if parse_only {
            self.parsed += 1;
            let output = self.bash(&without_placeholders(&scan.body), true);
            return succeeded(&command.text, 0, &output);
        }
        self.run += usize::from(block.language != "setup");
        let body = self.with_free_ports(&scan.body);
        let server = SERVERS.iter().find(|(name, _)| {
            body.strip_prefix(name)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with([' ', '\n']))
        });
        if let Some((_, port)) = server {
            return self.serve(&body, *port);
        }
        let begun = Instant::now();
        let output = self.bash(&body, false);
        if begun.elapsed() > SLOW {
            let seconds = begun.elapsed().as_secs_f64();
            println!("{}:{}: {seconds:.1} s", self.page.path, command.line);
        }
        succeeded(&command.text, command.exit, &output)?;
        match &command.shown {
            Some(shown) => compare(
                &command.text,
                &String::from_utf8_lossy(&output.stdout),
                shown,
            ),
            None => Ok(()),
        }
    }

    /// Runs a script where the last command of the block left off.
    fn bash(&self, script: &str, parse_only: bool) -> Output {
        let state = self.state.path().display();
        let script = format!(
            "[ -e {state}/env ] && . {state}/env && cd \"$(cat {state}/cwd)\"\n\
             {script}\ncode=$?; unset REEL_PARSE_ONLY; export -p > {state}/env; pwd > {state}/cwd; exit $code"
        );
        let mut command = Command::new("timeout");
        command.args(["-k", "5", "300", "bash", "-c", &script]);
        self.prepared(&mut command)
            .envs(parse_only.then_some(("REEL_PARSE_ONLY", "1")))
            .output()
            .unwrap()
    }

    fn output(&self, command: &mut Command) -> Output {
        self.prepared(command).output().unwrap()
    }

    /// A command in the folder of the page, with `reel` on its path and no setting of the caller.
    fn prepared<'c>(&self, command: &'c mut Command) -> &'c mut Command {
        for (name, _) in env::vars_os() {
            if name.to_string_lossy().starts_with("REEL_") {
                command.env_remove(name);
            }
        }
        let path = env::var("PATH").unwrap_or_default();
        let demo = self.page.text.contains("$DEMO").then(demo);
        command
            .current_dir(self.folder.path())
            .stdin(Stdio::null())
            .env("PATH", format!("{}:{path}", self.state.path().display()))
            .env("ROOT", root())
            .env("HOME", self.folder.path())
            .env("CURL_HOME", self.state.path())
            .envs(demo.map(|folder| ("DEMO", folder.join("demo-out"))))
    }

    /// The command with free ports of this machine for those of the page.
    fn with_free_ports(&mut self, command: &str) -> String {
        let mut text = command.to_owned();
        for host in ["127.0.0.1:", "localhost:"] {
            let mut parts = text.split(host);
            let mut replaced = parts.next().unwrap_or_default().to_owned();
            for part in parts {
                let digits =
                    part.len() - part.trim_start_matches(|c: char| c.is_ascii_digit()).len();
                let (port, rest) = part.split_at(digits);
                let port = port.parse().map_or(0, |port| self.free_port(port));
                replaced += &format!("127.0.0.1:{port}{rest}");
            }
            text = replaced;
        }
        text
    }

    fn free_port(&mut self, port: u16) -> u16 {
        let free = || {
            TcpListener::bind("127.0.0.1:0")
                .unwrap()
                .local_addr()
                .unwrap()
                .port()
        };
        *self.ports.entry(port).or_insert_with(free)
    }

    /// Starts a server and waits until it listens.
    fn serve(&mut self, body: &str, port: Option<u16>) -> Result<(), String> {
        let mut body = body.trim_end().trim_end_matches('&').trim_end().to_owned();
        let listen = body.split("--listen 127.0.0.1:").nth(1);
        let listen = listen.and_then(|rest| rest.split_whitespace().next()?.parse().ok());
        let listen: Option<u16> = match (listen, port) {
            (Some(port), _) => Some(port),
            (None, Some(port)) => {
                let port = self.free_port(port);
                body += &format!(" --listen 127.0.0.1:{port}");
                Some(port)
            }
            (None, None) => None,
        };
        let log = self
            .state
            .path()
            .join(format!("log-{}", self.servers.len()));
        let file = fs::File::create(&log).unwrap();
        let mut command = Command::new("bash");
        command
            .args(["-c", &format!("exec {body}")])
            .process_group(0)
            .stdout(file.try_clone().unwrap())
            .stderr(file);
        let child = self.prepared(&mut command).spawn().unwrap();
        let mut server = Server {
            command: body,
            child,
            log,
        };
        let address = listen.map(|port| SocketAddr::from(([127, 0, 0, 1], port)));
        let begun = Instant::now();
        while let Some(address) = address {
            if TcpStream::connect(address).is_ok() {
                break;
            }
            if server.child.try_wait().unwrap().is_some() || begun.elapsed() > PATIENCE {
                return Err(server.describe("does not listen"));
            }
            thread::sleep(Duration::from_millis(20));
        }
        self.servers.push(server);
        Ok(())
    }

    /// Runs what stands behind `>>>`, and compiles whole programs, where there is a Python.
    fn python(&mut self, block: &Block) -> Result<(), String> {
        let Some(python) = self.python else {
            self.foreign
                .push(format!("{}:{}: python", self.page.path, block.line));
            return Ok(());
        };
        if !block.text.starts_with(">>> ") {
            self.parsed += 1;
            let program = "import sys; compile(sys.argv[1], 'block', 'exec')";
            let output = self.output(Command::new(python).args(["-c", program, &block.text]));
            return succeeded("python", 0, &output);
        }
        for session in block.text.split(">>> ").skip(1) {
            let (expression, shown) = session.split_once('\n').unwrap_or((session, ""));
            let program = format!("import datasets\nprint(repr({expression}))");
            let output = self.output(Command::new(python).args(["-c", &program]));
            self.run += 1;
            succeeded(expression, 0, &output)?;
            let shown: Vec<String> = shown.lines().map(str::to_owned).collect();
            compare(expression, &String::from_utf8_lossy(&output.stdout), &shown)?;
        }
        Ok(())
    }
}

/// A server that a page started.
struct Server {
    command: String,
    child: Child,
    log: PathBuf,
}

impl Server {
    /// Ends it as Ctrl-C does; a failure if it ended before, or does not end.
    fn stop(mut self) -> Option<String> {
        if self.child.try_wait().unwrap().is_some() {
            return Some(self.describe("ended by itself"));
        }
        self.signal("-INT");
        let begun = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            if begun.elapsed() > PATIENCE {
                return Some(self.describe("does not end"));
            }
            thread::sleep(Duration::from_millis(20));
        }
        None
    }

    fn signal(&self, signal: &str) {
        let group = format!("-{}", self.child.id());
        let _ = Command::new("kill").args([signal, "--", &group]).status();
    }

    fn describe(&self, problem: &str) -> String {
        let log = fs::read_to_string(&self.log).unwrap_or_default();
        format!("{} {problem}:\n{log}", self.command)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            self.signal("-KILL");
            let _ = self.child.wait();
        }
    }
}

/// A command of a block.
pub struct Typed {
    /// Number of its first line.
    pub line: usize,
    /// As it stands in the page.
    pub text: String,
    /// What a comment `# exit code N` says, else 0.
    exit: i32,
    /// In a console, the lines shown below it.
    shown: Option<Vec<String>>,
}

/// The commands of a block. One goes on over lines that end with a backslash or inside of quotes.
pub fn commands(block: &Block) -> Vec<Typed> {
    let is_console = block.language == "console";
    let mut commands: Vec<Typed> = Vec::new();
    let mut is_open = false;
    for (line, content) in (block.line + 1..).zip(block.text.lines()) {
        if is_open && let Some(command) = commands.last_mut() {
            command.text += &format!("\n{content}");
        } else if let Some(typed) = content.strip_prefix(if is_console { "$ " } else { "" }) {
            commands.push(Typed {
                line,
                text: typed.to_owned(),
                exit: 0,
                shown: is_console.then(Vec::new),
            });
        } else if let Some(shown) = commands.last_mut().and_then(|it| it.shown.as_mut()) {
            shown.push(content.to_owned());
            continue;
        }
        is_open = commands.last().is_some_and(|it| Scan::of(&it.text).is_open);
    }
    commands.retain_mut(|command| {
        let scan = Scan::of(&command.text);
        let code = scan.comment.split("exit code ").nth(1);
        command.exit = code.and_then(|code| code.trim().parse().ok()).unwrap_or(0);
        !scan.segments.is_empty()
    });
    commands
}

/// A command as far as the test understands the shell.
#[derive(Default)]
pub struct Scan {
    /// The words of each part, assignments before the program left out.
    pub segments: Vec<Vec<String>>,
    /// The command without its comments.
    body: String,
    comment: String,
    /// Whether it goes on in the next line.
    is_open: bool,
}

impl Scan {
    /// Splits a command as a shell does.
    pub fn of(text: &str) -> Self {
        let mut scan = Self::default();
        let mut word = String::new();
        let mut is_first = true;
        let mut quote = None;
        let mut chars = text.chars().peekable();
        while let Some(char) = chars.next() {
            let before = scan.body.chars().last();
            if quote.is_none() && char == '#' && before.is_none_or(char::is_whitespace) {
                while let Some(char) = chars.next_if(|char| *char != '\n') {
                    scan.comment.push(char);
                }
                continue;
            }
            scan.body.push(char);
            match (quote, char) {
                (Some(mark), _) if char == mark => quote = None,
                (None | Some('"'), '\\') => match chars.next() {
                    None => scan.is_open = true,
                    Some(next) => {
                        scan.body.push(next);
                        if next == '\n' {
                            scan.end_word(&mut word, &mut is_first);
                        } else {
                            word.push(next);
                        }
                    }
                },
                (None, '\'' | '"') => quote = Some(char),
                (None, ' ' | '\t') => scan.end_word(&mut word, &mut is_first),
                (None, '&') if before == Some('>') => word.push(char),
                (None, ';' | '|' | '&' | '\n') => {
                    scan.end_word(&mut word, &mut is_first);
                    is_first = true;
                }
                _ => word.push(char),
            }
        }
        scan.end_word(&mut word, &mut is_first);
        scan.is_open |= quote.is_some();
        scan
    }

    fn end_word(&mut self, word: &mut String, is_first: &mut bool) {
        let word = std::mem::take(word);
        if word.is_empty() {
            return;
        }
        let is_name = |name: &str| name.chars().all(|c| c.is_ascii_uppercase() || c == '_');
        let is_assignment = word.split_once('=').is_some_and(|(name, _)| is_name(name));
        match self.segments.last_mut() {
            Some(segment) if !*is_first => segment.push(word),
            _ if is_assignment => {}
            _ => {
                self.segments.push(vec![word]);
                *is_first = false;
            }
        }
    }
}

/// Whether arguments of a program are looked up instead of used: builds take too long.
fn is_checked(program: &str) -> bool {
    matches!(program, "make" | "cargo")
}

/// Looks up the target of `make`, or the package of `cargo`.
pub fn checked(words: &[String]) -> Result<(), String> {
    let root = root();
    if words[0] == "make" {
        let makefile = fs::read_to_string(root.join("Makefile")).unwrap();
        let mut targets = words[1..].iter();
        return match targets.find(|it| !it.contains('=') && !it.starts_with('-')) {
            Some(target) if !makefile.contains(&format!("\n{target}:")) => {
                Err(format!("make {target}: the Makefile has no such target"))
            }
            _ => Ok(()),
        };
    }
    let package = words.iter().skip_while(|it| *it != "-p").nth(1);
    match package.map(|name| name.strip_prefix("reel-").unwrap_or(name)) {
        Some(name) if !root.join("src").join(name).exists() => {
            Err(format!("{}: there is no such package", words.join(" ")))
        }
        _ => Ok(()),
    }
}

/// `<episode>` without its brackets, which a shell would take for files.
pub fn without_placeholders(command: &str) -> String {
    let mut parts = command.split('<');
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let name = part.split_once('>').filter(|(name, _)| {
            !name.is_empty()
                && name
                    .chars()
                    .all(|char| char.is_alphanumeric() || "-_.".contains(char))
        });
        match name {
            Some((name, rest)) => text += &format!("{name}{rest}"),
            None => text += &format!("<{part}"),
        }
    }
    text
}

fn succeeded(command: &str, exit: i32, output: &Output) -> Result<(), String> {
    if output.status.code() == Some(exit) {
        return Ok(());
    }
    Err(format!(
        "{command}\n{} instead of {exit}\n{}{}",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    ))
}

/// Every line that is shown was printed, in this order; `...` stands for lines left out, and only
/// there may be some.
fn compare(command: &str, printed: &str, shown: &[String]) -> Result<(), String> {
    let mut rest = printed.trim_end().lines();
    let mut gap = false;
    for line in shown {
        if line == "..." {
            gap = true;
            continue;
        }
        let found = if gap {
            rest.any(|it| it == line)
        } else {
            rest.next() == Some(line.as_str())
        };
        if !found {
            return Err(format!(
                "{command}\nprints no such line there: {line}\nbut:\n{printed}"
            ));
        }
        gap = false;
    }
    if gap || rest.next().is_none() {
        return Ok(());
    }
    Err(format!("{command}\nprints more than is shown:\n{printed}"))
}
