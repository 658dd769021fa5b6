//! An agent on our standard input and output, and a server as a child process: lines of JSON both
//! ways, as they came.

use std::{
    io::{self, Read, Write},
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex, mpsc},
    thread,
};

use crate::{ProxyError, Setup, session::Session, sessions::Sessions, stop};

/// Starts the server and passes lines until one side is gone or the process shall end; gives the
/// server's exit code, where it ended by itself.
///
/// # Errors
/// When the server cannot be started.
pub fn run_stdio(setup: Arc<Setup>, command: &[String]) -> Result<Option<i32>, ProxyError> {
    let failed = |source| ProxyError::Spawn {
        command: setup.rules.without_secrets(&command.join(" ")),
        source,
    };
    let (program, arguments) = command
        .split_first()
        .ok_or_else(|| failed(io::ErrorKind::InvalidInput.into()))?;
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(failed)?;
    let (to_server, from_server) = (child.stdin.take(), child.stdout.take());
    let session = Sessions::new(setup.clone()).begin();
    session.set_one_way_in();
    let to_agent = Arc::new(Mutex::new(io::stdout()));
    let (gone, over) = mpsc::channel();

    let (at_agent, say, limit) = (session.clone(), to_agent.clone(), setup.message_max);
    thread::spawn(move || {
        let Some(to_server) = to_server else { return };
        // When this thread ends, the server's standard input is closed.
        drop(pass(
            io::stdin(),
            limit,
            &at_agent,
            to_server,
            |line| match at_agent.agent_says(line) {
                Ok(_) => Some(line.to_vec()),
                Err(refusal) => {
                    if let (Some(error), Ok(mut agent)) = (refusal.json(None), say.lock()) {
                        let _ = agent
                            .write_all(format!("{error}\n").as_bytes())
                            .and_then(|()| agent.flush());
                    }
                    None
                }
            },
        ));
    });
    let at_server = session.clone();
    let server_gone = gone.clone();
    thread::spawn(move || {
        if let Some(from_server) = from_server {
            drop(pass(
                from_server,
                limit,
                &at_server,
                Shared(to_agent),
                |line| match at_server.server_says(line) {
                    Ok(()) => Some(line.to_vec()),
                    Err(refusal) => refusal
                        .json(None)
                        .map(|error| format!("{error}\n").into_bytes()),
                },
            ));
        }
        let _ = server_gone.send(End::Server);
    });
    thread::spawn(move || {
        // Without signals the end of the agent is what ends this.
        if stop::wait().is_ok() {
            let _ = gone.send(End::Stopped);
        }
    });
    let code = match over.recv() {
        Ok(End::Server) => {
            session.end("the server is gone");
            child.wait()?.code()
        }
        Ok(End::Stopped) | Err(_) => {
            session.end("the recorder was stopped");
            end(&mut child);
            None
        }
    };
    setup.endings.wait();
    Ok(code)
}

enum End {
    Server,
    Stopped,
}

/// The child gets what a terminal would have sent it; it may have got that already.
fn end(child: &mut Child) {
    if !matches!(child.try_wait(), Ok(Some(_))) {
        let _ = child.kill();
        let _ = child.wait();
    }
}

struct Shared(Arc<Mutex<io::Stdout>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut out = self
            .0
            .lock()
            .map_err(|_| io::Error::other("the output broke down"))?;
        // A line at once: refusals come from another thread.
        out.write_all(bytes)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0
            .lock()
            .map_err(|_| io::Error::other("the output broke down"))?
            .flush()
    }
}

/// Passes lines on until one side is gone. `look` gives what is passed on in a line's place. Lines
/// over the limit pass as they are.
fn pass(
    mut from: impl Read,
    limit: usize,
    session: &Session,
    mut to: impl Write,
    look: impl Fn(&[u8]) -> Option<Vec<u8>>,
) -> io::Result<()> {
    let (mut held, mut piece, mut too_long) = (Vec::new(), vec![0; 64 << 10], false);
    loop {
        let count = match from.read(&mut piece) {
            Ok(0) => break,
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        for part in piece[..count].split_inclusive(|byte| *byte == b'\n') {
            let ends = part.ends_with(b"\n");
            if too_long {
                to.write_all(part)?;
                too_long = !ends;
                continue;
            }
            held.extend_from_slice(part);
            if ends {
                if let Some(line) = look(&held) {
                    to.write_all(&line)?;
                }
                held.clear();
            } else if held.len() > limit {
                session.too_large("a line");
                session.unanswered(None, "a message was too large to be read");
                to.write_all(&held)?;
                held.clear();
                too_long = true;
            }
        }
        to.flush()?;
    }
    // What has no end of line is passed on as it is.
    to.write_all(&held)?;
    to.flush()
}
