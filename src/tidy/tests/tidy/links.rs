//! Links and references: every relative link and anchor of a Markdown page leads somewhere, every
//! page that a source file names exists with its anchor, and external links are well formed.
//! Reads files of the repository only and never opens a connection.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use reel_tidy::{files, root};

use super::none;

/// Pages that a build writes: links to them are not followed. Paths from the root; a `/` at the end
/// stands for all that is below.
const GENERATED: &[&str] = &[];

/// Endings of the files in which names of pages are checked. Pages check their own links as well.
const NAMING: &[&str] = &[
    ".html", ".md", ".mjs", ".proto", ".py", ".rs", ".sh", ".sql", ".svelte", ".toml", ".ts",
    "Makefile",
];

/// Folders of the root: a name that begins with one is a path.
const ROOTED: &[&str] = &[
    "dashboards/",
    "docs/",
    "queries/",
    "schemas/",
    "src/",
    "tests/",
    "traces/",
];

/// Last labels of host names that nobody outside of one network can reach.
const PRIVATE: &[&str] = &[
    "corp",
    "home",
    "internal",
    "intranet",
    "lan",
    "local",
    "localdomain",
    "private",
];

/// Last labels that are reserved for examples and tests. A link to one leads nowhere.
const RESERVED: &[&str] = &["example", "invalid", "localhost", "test"];

/// Citations of documents that are not in the repository. The specification is `docs/spec.md`.
const DANGLING: &[&str] = &["SPEC section", "CONTRACT section", "(contract, section"];

/// This file, whose tests name pages that do not exist.
const OWN: &str = "tidy/links.rs";

#[test]
fn links_of_pages_lead_somewhere() {
    let files = files();
    let pages = Pages::of(&files);
    let written = files
        .iter()
        .filter(|(path, _)| is_page(path) && !path.contains("/prompts/"));
    let found: Vec<String> = written
        .flat_map(|(path, text)| links(text).into_iter().map(move |link| (path, link)))
        .filter_map(|(path, (line, target))| {
            let wrong = pages.wrong_with_link(path, &target)?;
            Some(format!("{path}:{line}: link `{target}`: {wrong}"))
        })
        .collect();
    none(found.into_iter());
}

#[test]
fn pages_that_files_name_exist() {
    let files = files();
    let pages = Pages::of(&files);
    let naming = files.iter().filter(|(path, _)| names_pages(path));
    let found: Vec<String> = naming
        .flat_map(|(path, text)| references(text).into_iter().map(move |named| (path, named)))
        .filter_map(|(path, (line, name))| {
            let wrong = pages.wrong_with_reference(name)?;
            Some(format!("{path}:{line}: `{name}`: {wrong}"))
        })
        .collect();
    none(found.into_iter());
}

/// A guide that no page links to is a guide that nobody finds.
#[test]
fn every_guide_is_linked() {
    let files = files();
    let mut linked = BTreeSet::new();
    for (page, text) in files.iter().filter(|(path, _)| is_page(path)) {
        for (_, target) in links(text) {
            let path = target.split('#').next().unwrap_or_default();
            linked.extend(resolved(page, path).filter(|path| path != page));
        }
    }
    let in_docs = |path: &str| path.starts_with("docs/") && path.matches('/').count() == 1;
    let guides = files
        .iter()
        .map(|(path, _)| path)
        .filter(|path| is_page(path) && in_docs(path));
    none(
        guides
            .filter(|path| !linked.contains(*path) && !path.ends_with("SUMMARY.md"))
            .map(|path| format!("{path}: no page links to it")),
    );
}

#[test]
fn no_private_host_is_named() {
    let files = files();
    let found: Vec<String> = files
        .iter()
        .filter(|(path, _)| names_pages(path))
        .flat_map(|(path, text)| hosts(text).into_iter().map(move |host| (path, host)))
        .filter(|(_, (_, host))| PRIVATE.contains(&last_label(host)))
        .map(|(path, (line, host))| format!("{path}:{line}: `{host}` is no public host"))
        .collect();
    none(found.into_iter());
}

#[test]
fn no_unpublished_document_is_cited() {
    let files = files();
    let found: Vec<String> = files
        .iter()
        .filter(|(path, _)| names_pages(path))
        .flat_map(|(path, text)| DANGLING.iter().map(move |words| (path, text, *words)))
        .filter(|(_, text, words)| text.contains(*words))
        .map(|(path, _, words)| format!("{path}: `{words}`: cite an anchor of docs/spec.md"))
        .collect();
    none(found.into_iter());
}

/// The Markdown pages of the repository and the anchors of each, by path from the root.
struct Pages {
    root: PathBuf,
    anchors: BTreeMap<String, BTreeSet<String>>,
}

impl Pages {
    /// The pages among files.
    fn of(files: &[(String, String)]) -> Self {
        let pages = files.iter().filter(|(path, _)| is_page(path));
        let anchors = pages
            .map(|(path, text)| (path.clone(), anchors(text)))
            .collect();
        Self {
            root: root(),
            anchors,
        }
    }

    /// What is wrong with a link of a page; `None` if it leads somewhere.
    fn wrong_with_link(&self, page: &str, target: &str) -> Option<String> {
        if target.contains("://") {
            return wrong_with_url(target).map(str::to_owned);
        }
        if target.starts_with("mailto:") {
            return None;
        }
        let (path, anchor) = split_anchor(target);
        let path = if path.is_empty() {
            Some(page.to_owned())
        } else {
            resolved(page, path)
        };
        let Some(path) = path else {
            return Some("it leaves the repository".to_owned());
        };
        if is_generated(&path) {
            return None;
        }
        if !self.anchors.contains_key(&path) && !self.root.join(&path).exists() {
            return Some(format!("there is no `{path}`"));
        }
        let anchor = anchor?;
        let Some(anchors) = self.anchors.get(&path) else {
            return Some(format!("`{path}` is no page with headings"));
        };
        (!anchors.contains(anchor)).then(|| format!("`{path}` has no heading `#{anchor}`"))
    }

    /// What is wrong with a page that a text names; `None` if there is such a page. A name that
    /// begins with a folder of the root is a path; of any other name the file name has to exist.
    fn wrong_with_reference(&self, name: &str) -> Option<String> {
        let (path, anchor) = split_anchor(name);
        let path = path.trim_start_matches(['.', '/']);
        if is_generated(path) {
            return None;
        }
        let is_path = ROOTED.iter().any(|folder| path.starts_with(*folder));
        let fits = |page: &str| {
            if is_path {
                page == path
            } else {
                file_name(page) == file_name(path)
            }
        };
        let mut pages = self
            .anchors
            .iter()
            .filter(|(page, _)| fits(page))
            .peekable();
        if pages.peek().is_none() {
            return Some("there is no such page".to_owned());
        }
        let anchor = anchor?;
        let known = pages.any(|(_, anchors)| anchors.contains(anchor));
        (!known).then(|| format!("it has no heading `#{anchor}`"))
    }
}

/// Whether a file is a Markdown page.
fn is_page(path: &str) -> bool {
    path.ends_with(".md")
}

/// Whether names of pages in a file are checked.
fn names_pages(path: &str) -> bool {
    NAMING.iter().any(|ending| path.ends_with(*ending)) && !path.ends_with(OWN)
}

/// Whether a build writes this page.
fn is_generated(path: &str) -> bool {
    GENERATED
        .iter()
        .any(|written| path == *written || (written.ends_with('/') && path.starts_with(*written)))
}

/// What follows the last slash of a path.
fn file_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or_default()
}

/// A path and what follows its `#`.
fn split_anchor(target: &str) -> (&str, Option<&str>) {
    match target.split_once('#') {
        Some((path, anchor)) => (path, Some(anchor)),
        None => (target, None),
    }
}

/// The path from the root that a link of a page means; `None` if it leaves the repository.
fn resolved(page: &str, target: &str) -> Option<String> {
    let folder = page.rsplit_once('/').map_or("", |(folder, _)| folder);
    let from = if target.starts_with('/') { "" } else { folder };
    let mut parts: Vec<&str> = Vec::new();
    for part in from.split('/').chain(target.split('/')) {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop()?;
            }
            name => parts.push(name),
        }
    }
    Some(parts.join("/"))
}

/// What is wrong with the form of an external link; `None` if nothing is.
fn wrong_with_url(url: &str) -> Option<&'static str> {
    let (scheme, rest) = url.split_once("://")?;
    if !matches!(scheme, "http" | "https") {
        return Some("its scheme is neither http nor https");
    }
    if url.chars().any(char::is_whitespace) {
        return Some("it has white space");
    }
    if url.ends_with(['.', ',', ';', ':', '!', '?', '\'', '"']) {
        return Some("it ends with punctuation");
    }
    let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
    (!is_public(host)).then_some("its host is no public name")
}

/// Whether a host is a name that anybody can look up: no address, port, user or private name.
fn is_public(host: &str) -> bool {
    let is_name = |label: &str| {
        !label.is_empty()
            && label
                .chars()
                .all(|char| char.is_ascii_alphanumeric() || char == '-')
    };
    let last = last_label(host);
    host.contains('.')
        && host.split('.').all(is_name)
        && last.len() > 1
        && last.chars().all(|char| char.is_ascii_alphabetic())
        && !PRIVATE.contains(&last)
        && !RESERVED.contains(&last)
}

/// What follows the last dot of a host name.
fn last_label(host: &str) -> &str {
    host.rsplit('.').next().unwrap_or_default()
}

/// The hosts of all URLs of a text, code included, with their lines.
fn hosts(text: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        for (start, mark) in line.match_indices("://") {
            let rest = &line[start + mark.len()..];
            let is_part = |char: char| char.is_ascii_alphanumeric() || char == '-' || char == '.';
            let end = rest.find(|char: char| !is_part(char)).unwrap_or(rest.len());
            found.push((number, rest[..end].trim_end_matches('.')));
        }
    }
    found
}

/// The Markdown pages that a text names, with their anchors and lines.
fn references(text: &str) -> Vec<(usize, &str)> {
    let is_part =
        |char: char| char.is_ascii_alphanumeric() || matches!(char, '_' | '-' | '.' | '/' | '#');
    let mut found = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        for word in line.split(|char: char| !is_part(char)) {
            let name = word.trim_end_matches(['.', '/', '-', '#']);
            let (path, _) = split_anchor(name);
            // What begins with two slashes is the rest of a URL, and `*.md` names no page.
            let is_named = path.ends_with(".md") && !path.ends_with("/.md") && path != ".md";
            if is_named && !name.starts_with("//") {
                found.push((number, name));
            }
        }
    }
    found
}

/// The anchors of a page: its headings as GitHub and mdBook name them, and `<a id="...">`.
fn anchors(text: &str) -> BTreeSet<String> {
    let text = without_blocks(text);
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let mut found = BTreeSet::new();
    for heading in text.lines().filter_map(heading) {
        let slug = slug(heading);
        let count = counts.entry(slug.clone()).or_insert(0);
        found.insert(if *count == 0 {
            slug
        } else {
            format!("{slug}-{count}")
        });
        *count += 1;
    }
    let ids = text
        .split("<a id=\"")
        .skip(1)
        .filter_map(|rest| rest.split_once('"'));
    found.extend(ids.map(|(id, _)| id.to_owned()));
    found
}

/// The text of a heading; `None` if a line is none.
fn heading(line: &str) -> Option<&str> {
    let text = line.trim_start_matches('#');
    let depth = line.len() - text.len();
    text.strip_prefix(' ')
        .filter(|_| (1..=6).contains(&depth))
        .map(str::trim)
}

/// The anchor of a heading: lower case, words joined by hyphens, without punctuation and without
/// the targets of links.
fn slug(heading: &str) -> String {
    let mut text = String::new();
    let mut rest = heading;
    while let Some((before, after)) = rest.split_once("](") {
        text.push_str(before);
        rest = after.split_once(')').map_or("", |(_, after)| after);
    }
    text.push_str(rest);
    text.chars()
        .filter(|char| char.is_alphanumeric() || matches!(char, ' ' | '-' | '_'))
        .flat_map(char::to_lowercase)
        .map(|char| if char == ' ' { '-' } else { char })
        .collect()
}

/// The targets of all links and images of a page outside of code, with their lines.
fn links(text: &str) -> Vec<(usize, String)> {
    let text = without_spans(&without_blocks(text));
    let line_of = |start: usize| text[..start].matches('\n').count() + 1;
    let mut found = Vec::new();
    for (start, mark) in text.match_indices("](") {
        found.extend(target(&text[start + mark.len()..]).map(|target| (line_of(start), target)));
    }
    for (start, _) in text.match_indices("<http") {
        let rest = &text[start + 1..];
        found.extend(
            rest.split_once('>')
                .map(|(url, _)| (line_of(start), url.to_owned())),
        );
    }
    for attribute in [" href=\"", " src=\""] {
        for (start, mark) in text.match_indices(attribute) {
            let rest = &text[start + mark.len()..];
            found.extend(
                rest.split_once('"')
                    .map(|(url, _)| (line_of(start), url.to_owned())),
            );
        }
    }
    for (number, line) in (1..).zip(text.lines()) {
        found.extend(definition(line).map(|target| (number, target.to_owned())));
    }
    found
}

/// The target of a link from behind its `](`, without a title; `None` if it has no end.
fn target(rest: &str) -> Option<String> {
    if let Some(angled) = rest.strip_prefix('<') {
        return angled.split_once('>').map(|(target, _)| target.to_owned());
    }
    let mut depth = 0_usize;
    for (index, char) in rest.char_indices() {
        match char {
            '(' => depth += 1,
            ')' if depth > 0 => depth -= 1,
            ')' => {
                let inside = &rest[..index];
                let target = inside
                    .split_once(" \"")
                    .map_or(inside, |(target, _)| target);
                return Some(target.trim().to_owned());
            }
            _ => {}
        }
    }
    None
}

/// The target of `[name]: target`; `None` if a line defines no link. Footnotes are none.
fn definition(line: &str) -> Option<&str> {
    let (name, target) = line.trim_start().strip_prefix('[')?.split_once("]: ")?;
    let is_name = !name.is_empty() && !name.starts_with('^') && !name.contains(']');
    target.split_whitespace().next().filter(|_| is_name)
}

/// The text with the lines of fenced code emptied; the others keep their numbers.
fn without_blocks(text: &str) -> String {
    let mut open: Option<(char, usize)> = None;
    let mut kept = String::with_capacity(text.len());
    for line in text.lines() {
        match (open, fence(line)) {
            (None, Some((mark, length, _))) => open = Some((mark, length)),
            (Some((mark, length)), Some((other, long, bare)))
                if mark == other && long >= length && bare =>
            {
                open = None;
            }
            (None, None) => kept.push_str(line),
            _ => {}
        }
        kept.push('\n');
    }
    kept
}

/// The mark of a line that opens or closes a block of code: its character, its length, and
/// whether nothing follows it.
fn fence(line: &str) -> Option<(char, usize, bool)> {
    let line = line.trim();
    let mark = line
        .chars()
        .next()
        .filter(|mark| matches!(mark, '`' | '~'))?;
    let rest = line.trim_start_matches(mark);
    let length = line.len() - rest.len();
    (length >= 3 && !rest.contains('`')).then_some((mark, length, rest.is_empty()))
}

/// The text with inline code blanked, so that brackets in it make no links.
fn without_spans(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find('`') {
        let (before, span) = rest.split_at(start);
        kept.push_str(before);
        let ticks = span.len() - span.trim_start_matches('`').len();
        let length = closing(&span[ticks..], ticks).map_or(ticks, |end| ticks + end + ticks);
        let (span, after) = span.split_at(length);
        kept.extend(
            span.chars()
                .map(|char| if char == '\n' { '\n' } else { ' ' }),
        );
        rest = after;
    }
    kept.push_str(rest);
    kept
}

/// Where the run of as many backticks begins that closes inline code, within its paragraph; `None`
/// if nothing closes it.
fn closing(text: &str, ticks: usize) -> Option<usize> {
    let paragraph = text.split("\n\n").next().unwrap_or(text);
    let mut from = 0;
    while let Some(found) = paragraph[from..].find('`') {
        let start = from + found;
        let run = paragraph[start..]
            .chars()
            .take_while(|char| *char == '`')
            .count();
        if run == ticks {
            return Some(start);
        }
        from = start + run;
    }
    None
}

#[test]
fn headings_become_the_anchors_of_their_pages() {
    let page = "# Top\n## Terms of `real-repo`\n### What is [said](a.md): *all*\n## Top\n\
                ```sh\n# no heading\n```\n#no heading\n<a id=\"named\"></a>\n";
    let expected = [
        "named",
        "terms-of-real-repo",
        "top",
        "top-1",
        "what-is-said-all",
    ];
    assert_eq!(anchors(page).into_iter().collect::<Vec<_>>(), expected);
}

#[test]
fn links_are_found_outside_of_code_alone() {
    let page = "[a](b.md) and\n![c](d.png \"title\"), `[no](no.md)`\n\n```\n[no](no.md)\n```\n\
                <https://e.org>\n[f]: g.md\n[`code`](h(1).md#i) ``[no](` no.md)``\n";
    let found = links(page);
    let expected = [
        (1, "b.md"),
        (2, "d.png"),
        (9, "h(1).md#i"),
        (7, "https://e.org"),
        (8, "g.md"),
    ];
    assert_eq!(
        found
            .iter()
            .map(|(line, to)| (*line, to.as_str()))
            .collect::<Vec<_>>(),
        expected
    );
}

#[test]
fn a_link_is_resolved_from_the_folder_of_its_page() {
    assert_eq!(resolved("docs/a.md", "b.md").as_deref(), Some("docs/b.md"));
    assert_eq!(
        resolved("docs/a.md", "../schemas/./b.md").as_deref(),
        Some("schemas/b.md")
    );
    assert_eq!(resolved("README.md", "docs").as_deref(), Some("docs"));
    assert_eq!(resolved("docs/a.md", "../../shared/b.md"), None);
}

#[test]
fn broken_links_and_references_are_seen() {
    let texts = [
        ("docs/a.md", "# Here\n"),
        ("src/x/prompts/b.md", "# There\n"),
    ];
    let files: Vec<(String, String)> = texts
        .iter()
        .map(|(path, text)| ((*path).to_owned(), (*text).to_owned()))
        .collect();
    let pages = Pages::of(&files);
    assert_eq!(pages.wrong_with_reference("docs/a.md#here"), None);
    assert_eq!(pages.wrong_with_reference("../../docs/a.md"), None);
    assert_eq!(pages.wrong_with_reference("prompts/b.md#there"), None);
    assert!(pages.wrong_with_reference("docs/a.md#there").is_some());
    assert!(pages.wrong_with_reference("docs/b.md").is_some());
    assert_eq!(pages.wrong_with_reference("corpus/a.md"), None);
    assert!(pages.wrong_with_reference("c.md").is_some());
    assert_eq!(pages.wrong_with_link("docs/a.md", "#here"), None);
    assert!(pages.wrong_with_link("docs/a.md", "#there").is_some());
    assert!(
        pages
            .wrong_with_link("docs/a.md", "no-such-page.png")
            .is_some()
    );
    assert!(pages.wrong_with_link("docs/a.md", "../../b.md").is_some());
    assert!(
        pages
            .wrong_with_link("docs/a.md", "http://localhost:8801")
            .is_some()
    );
}

#[test]
fn the_form_of_external_links_is_checked() {
    for url in [
        "https://mcap.dev",
        "https://github.com/a/b/tree/main#c",
        "http://a-b.org/?c=d",
    ] {
        assert_eq!(wrong_with_url(url), None, "{url}");
    }
    for url in [
        "ftp://mcap.dev",
        "https://",
        "https://mcap",
        "https://mcap.dev.",
        "https://mcap.dev/a,",
        "https://mcap.dev/a b",
        "https://me@mcap.dev",
        "https://10.0.0.1/a",
        "https://mirror.example/a",
        "https://mirror.internal/a",
    ] {
        assert!(wrong_with_url(url).is_some(), "{url}");
    }
}

#[test]
fn names_of_pages_are_found_in_comments() {
    let text = "// (docs/a.md#b); `../c.md`, *.md\n# https://d.org/e.md and F.md.\n";
    assert_eq!(
        references(text),
        [(1, "docs/a.md#b"), (1, "../c.md"), (2, "F.md")]
    );
    assert_eq!(
        hosts("a\nsee https://d.org/e. Or http://f:80."),
        [(2, "d.org"), (2, "f")]
    );
}
