//! Names and counts: commands in blocks and in sentences exist with their options, and a number
//! before a noun is how many there are.

use std::{collections::BTreeMap, fs};

use crate::{page::Block, reference, root, shell};

/// Pages that are not guides and name commands, too.
const OTHERS: &[&str] = &["ARCHITECTURE.md", "SECURITY.md"];

/// Number words that sentences use.
const NUMBERS: &[&str] = &[
    "zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten",
    "eleven", "twelve", "thirteen", "fourteen", "fifteen",
];

/// Every page that says what is so now, with its text outside of fenced blocks.
fn texts() -> Vec<(String, String)> {
    let guides = crate::pages()
        .into_iter()
        .map(|page| (page.path, page.text));
    let others = OTHERS.iter().map(|path| {
        let text = fs::read_to_string(root().join(path)).unwrap();
        ((*path).to_owned(), text)
    });
    let outside = |text: String| {
        text.split("\n```")
            .step_by(2)
            .collect::<Vec<_>>()
            .join("\n")
    };
    guides
        .chain(others)
        .map(|(path, text)| (path, outside(text)))
        .collect()
}

#[test]
fn commands_have_their_names_of_today() {
    let commands = reference::commands();
    let mut wrong = Vec::new();
    for page in crate::pages() {
        let is_shell =
            |block: &&Block| matches!(block.language.as_str(), "setup" | "sh" | "console");
        for command in page
            .blocks
            .iter()
            .filter(is_shell)
            .flat_map(shell::commands)
        {
            for words in shell::Scan::of(&command.text)
                .segments
                .iter()
                .filter(|it| it[0] == "reel")
            {
                let problem = wrong_with(&commands, words);
                wrong.extend(problem.map(|it| format!("{}:{}: {it}", page.path, command.line)));
            }
        }
    }
    for (path, text) in texts() {
        for span in text.split('`').skip(1).step_by(2) {
            let words: Vec<String> = span.split_whitespace().map(str::to_owned).collect();
            let problem = match words.first().map(String::as_str) {
                Some("reel") => wrong_with(&commands, &words),
                Some("make") => shell::checked(&words).err(),
                _ => None,
            };
            wrong.extend(problem.map(|problem| format!("{path}: `{span}`: {problem}")));
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

/// What is wrong with a command of Reel; `None` if it exists and has all its options.
fn wrong_with(commands: &BTreeMap<String, String>, words: &[String]) -> Option<String> {
    let mut name = "reel".to_owned();
    let mut rest = &words[1..];
    while let Some((word, after)) = rest.split_first() {
        let longer = format!("{name} {word}");
        if !commands.contains_key(&longer) {
            break;
        }
        (name, rest) = (longer, after);
    }
    let help = &commands[&name];
    let word = rest
        .first()
        .filter(|word| word.starts_with(|c: char| c.is_ascii_lowercase()));
    if let Some(word) = word.filter(|_| help.contains("\nCommands:\n")) {
        return Some(format!("`{name}` has no command `{word}`"));
    }
    let options = rest.iter().take_while(|word| *word != "--");
    for option in options.filter_map(|word| word.strip_prefix("--")) {
        let option = option.split('=').next().unwrap_or(option);
        let ends = |rest: &str| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '-');
        if !help.split(&format!("--{option}")).skip(1).any(ends) {
            return Some(format!("`{name}` has no option `--{option}`"));
        }
    }
    None
}

#[test]
fn counts_in_sentences_are_right() {
    let folder = |path: &str, ending: &str| {
        let entries = fs::read_dir(root().join(path)).unwrap();
        entries
            .filter(|entry| {
                let name = entry.as_ref().unwrap().file_name();
                name.to_string_lossy().ends_with(ending)
            })
            .count()
    };
    let counts = [
        ("named queries", folder("queries", ".sql")),
        ("failure rules", folder("queries/taxonomy", ".sql")),
    ];
    let mut wrong = Vec::new();
    for (path, text) in texts() {
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        for (noun, count) in counts {
            for (start, _) in text.match_indices(&format!(" {noun}")) {
                let word = text[..start].rsplit([' ', '(']).next().unwrap_or_default();
                let lower = word.to_lowercase();
                let said = NUMBERS.iter().position(|it| *it == lower);
                let said = said.or_else(|| lower.replace(',', "").parse().ok());
                if said.is_some_and(|said| said != count) {
                    wrong.push(format!("{path}: '{word} {noun}': there are {count}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}
