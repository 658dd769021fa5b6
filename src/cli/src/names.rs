//! The names of commands: how `reel --help` orders them, and what the old ones are called now.

use std::ffi::OsString;

use clap::{Command, CommandFactory as _};

/// The commands under their headings, as `reel --help` lists them.
#[rustfmt::skip]
const HEADINGS: [(&str, &[&str]); 7] = [
    ("Play and record", &["run", "bench", "demo", "serve", "mcp", "record", "test"]),
    ("Look and replay", &["show", "view", "replay", "branch", "diff", "pack", "unpack"]),
    ("Show and prove", &["share", "bundle", "verify", "leaderboard", "key"]),
    ("Explain failures", &["bisect", "blame", "attribute", "counterfactuals", "repair", "taxonomy", "claims", "report"]),
    ("Tables and training sets", &["import", "ingest", "query", "export", "publish"]),
    (
        "Groups of commands (`reel GROUP --help` lists them)",
        &[
            "trace", "store", "dataset", "train", "task", "scene", "agent", "server", "cluster", "dev",
        ],
    ),
    ("Set up", &["config", "completions", "man"]),
];

/// Old names of commands and the new ones, both as they are typed. The old ones work for one
/// version more.
const RENAMED: &[(&str, &str)] = &[
    ("annotate", "dataset annotate"),
    ("assets check", "scene check-assets"),
    ("compact", "trace compact"),
    ("config check", "server config check"),
    ("config default", "server config default"),
    ("copy", "trace copy"),
    ("doctor", "trace doctor"),
    ("expand", "trace expand"),
    ("faults", "agent faults"),
    ("frames", "trace frames"),
    ("gate", "dev gate"),
    ("gspo", "dataset gspo"),
    ("label", "store label"),
    ("logprobs", "trace logprobs"),
    ("mint", "dev mint"),
    ("mock-llm", "agent mock-llm"),
    ("perf", "dev perf"),
    ("recover", "trace recover"),
    ("reward", "store reward"),
    ("tables", "store"),
    ("tasks", "task"),
    ("token", "server token"),
    ("video", "trace video"),
];

/// The parser, whose help lists the commands under headings.
pub fn command_line() -> Command {
    let command = crate::Arguments::command();
    let mut text = String::from("Commands:\n");
    for (heading, names) in HEADINGS {
        text += &format!("\n{heading}:\n");
        for found in names
            .iter()
            .filter_map(|name| command.find_subcommand(name))
        {
            let about = found.get_about().map(ToString::to_string);
            text += &format!("  {:12} {}\n", found.get_name(), about.unwrap_or_default());
        }
    }
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{text}\nOptions:\n{{options}}\n\n\
         Every command has --help with examples. Guides: docs/SUMMARY.md."
    ))
}

/// The arguments with today's name of the command; names it on standard error where an old one
/// was typed.
pub fn current(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.collect();
    for (old, new) in RENAMED {
        let words = old.split(' ').count();
        let typed = arguments.get(1..=words).unwrap_or_default();
        if typed.iter().eq(old.split(' ')) {
            eprintln!("reel: `reel {old}` is `reel {new}` now; the old name goes in version 0.3");
            arguments.splice(1..=words, new.split(' ').map(OsString::from));
            break;
        }
    }
    arguments
}

#[cfg(test)]
mod tests {
    use clap::error::ErrorKind;

    use super::*;

    fn help(command: &str) -> String {
        let words = ["reel"].into_iter().chain(command.split(' '));
        let words = words.chain(["--help"]).map(OsString::from);
        let shown = command_line().try_get_matches_from(current(words));
        let shown = shown.expect_err("it is not run");
        assert_eq!(
            shown.kind(),
            ErrorKind::DisplayHelp,
            "reel {command}: {shown}"
        );
        shown.to_string()
    }

    #[test]
    fn every_old_name_is_parsed_as_the_new_one() {
        for (old, new) in RENAMED {
            assert_eq!(help(old), help(new), "{old}");
        }
    }

    #[test]
    fn every_command_has_one_heading() {
        let mut listed: Vec<&str> = HEADINGS
            .iter()
            .flat_map(|(_, names)| *names)
            .copied()
            .collect();
        listed.sort_unstable();
        let command = command_line();
        let mut there: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
        there.sort_unstable();
        listed.retain(|name| cfg!(feature = "cluster") || there.contains(name));
        assert_eq!(listed, there);
        command.debug_assert();
    }
}
