//! Progress bars on stderr, quiet where that is no terminal. With `REEL_PROGRESS=json` in the
//! environment, a line of JSON now and then instead, for whoever runs this command for others.

use std::{
    env,
    io::{self, Write as _},
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle, TermLike};

/// Lines of JSON a second.
const JSON_HZ: u8 = 4;

/// A bar over so many things.
pub fn bar(count: usize, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(count as u64);
    show(
        &bar,
        "{msg:12} [{bar:40}] {pos}/{len}  {elapsed} elapsed, {eta} left",
        "{len}",
    );
    bar.set_message(what.to_owned());
    bar
}

/// A spinner for work of unknown length.
#[cfg(feature = "analytics")]
pub fn spinner() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    show(&bar, "{spinner} {elapsed} {msg}", "null");
    bar
}

fn show(bar: &ProgressBar, for_people: &str, total: &str) {
    let in_json = env::var_os("REEL_PROGRESS").is_some_and(|form| form == "json");
    let for_programs =
        format!(r#"{{{{"progress":{{{{"done":{{pos}},"total":{total},"message":"{{msg}}"}}}}}}}}"#);
    if let Ok(style) =
        ProgressStyle::with_template(if in_json { &for_programs } else { for_people })
    {
        bar.set_style(style.progress_chars("=> "));
    }
    if in_json {
        bar.set_draw_target(ProgressDrawTarget::term_like_with_hz(
            Box::new(Lines),
            JSON_HZ,
        ));
    }
}

/// A terminal that writes whole lines to stderr and moves no cursor.
#[derive(Debug)]
struct Lines;

impl TermLike for Lines {
    fn width(&self) -> u16 {
        u16::MAX
    }

    fn move_cursor_up(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_down(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_right(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_left(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn write_line(&self, line: &str) -> io::Result<()> {
        self.write_str(line)
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        // A terminal's line is filled up with spaces.
        match text.trim() {
            "" => Ok(()),
            line => writeln!(io::stderr(), "{line}"),
        }
    }

    fn clear_line(&self) -> io::Result<()> {
        Ok(())
    }

    fn flush(&self) -> io::Result<()> {
        io::stderr().flush()
    }
}
