//! `reel leaderboard`: static pages that rank bundles, each of which visitors execute again in their browser.

use std::{
    cmp::Ordering,
    collections::{BTreeMap, BTreeSet},
    ffi::OsStr,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_bundle::{Cell, ClaimedEpisode, Manifest, ResultRow, Verification};
use reel_statistics::{bootstrap, mcnemar};
use reel_world::{Digest, printable_line};
use serde_json::{Value, json};

use super::{
    share,
    verify::{Checks, NOT_PROVEN, duplicates},
};
use crate::{ExitStatus, html::escaped};

/// All of a leaderboard for programs.
const RESULTS: &str = "results.json";
/// Samples of the bootstrap, and its seed.
const SAMPLES: usize = 10_000;
const SEED: u64 = 7;

/// Make static pages from a folder of bundles: every bundle is verified, those that hold are ranked
/// with intervals and paired tests, the others are listed with what does not hold. A row opens its
/// bundle in the visitor's browser, which executes it again. Exit code 3: some are not ranked.
///
/// Examples:
///   reel leaderboard submissions --tasks tasks --out site
///   python3 -m http.server --directory site          # any web server will do
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder with bundles (*.reel)
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Folder for the pages
    #[arg(long, value_name = "DIR", default_value = "site")]
    out: PathBuf,
    #[command(flatten)]
    checks: Checks,
    /// Title at the head of the page
    #[arg(long, default_value = "Results that anyone can check")]
    title: String,
    /// The player's page, as `make web` writes it, instead of the one in this build
    #[arg(long, value_name = "FILE")]
    player: Option<PathBuf>,
}

/// A bundle that holds.
struct Entry {
    /// Name of its file.
    file: String,
    manifest: Manifest,
    verification: Verification,
    result: ResultRow,
}

/// A row against the one above it, over the episodes of both.
struct Paired {
    difference: [f64; 3],
    p: f64,
}

/// Verifies the bundles of a folder and writes the pages.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let paths = bundles(&arguments.folder)?;
    let benchmark = arguments.checks.benchmark()?;
    let (mut entries, mut refused) = (Vec::new(), Vec::new());
    for path in &paths {
        let file = path.file_name().unwrap_or_default();
        let Some(file) = file.to_str().map(str::to_owned) else {
            let file = file.to_string_lossy().into_owned();
            refused.push((file, "its name is not UTF-8".to_owned()));
            continue;
        };
        match arguments.checks.verify(path, benchmark.as_ref(), None) {
            Err(error) => refused.push((file, format!("{error:#}"))),
            Ok((_, verification)) if !verification.holds => {
                refused.push((file, verification.to_string()));
            }
            Ok((manifest, verification)) => {
                let result = verification.result.clone();
                entries.push(Entry {
                    file,
                    manifest,
                    result: result.context("a table has its last line")?,
                    verification,
                });
            }
        }
    }
    without_duplicates(&mut entries, &mut refused);
    write(arguments, &entries, &refused)?;
    for (file, reason) in &refused {
        let told = printable_line(&format!("{file} is not ranked: {reason}"));
        eprintln!("reel: {told}");
    }
    println!(
        "{}: {} of {} bundles ranked",
        arguments.out.join("index.html").display(),
        entries.len(),
        paths.len()
    );
    Ok(match refused.is_empty() {
        true => ExitStatus::Success,
        false => ExitStatus::Partial,
    })
}

fn bundles(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let listed = fs::read_dir(folder)
        .with_context(|| format!("cannot read the folder {}", folder.display()))?;
    let mut paths = Vec::new();
    for entry in listed {
        let path = entry?.path();
        if path
            .extension()
            .is_some_and(|extension| extension == "reel")
        {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        bail!(
            "{} has no bundles (*.reel); `reel bundle` makes them",
            folder.display()
        );
    }
    paths.sort();
    Ok(paths)
}

/// Of bundles in which the same was played only the first is ranked.
fn without_duplicates(entries: &mut Vec<Entry>, refused: &mut Vec<(String, String)>) {
    let listed = entries.iter();
    let pairs = duplicates(listed.map(|entry| (Path::new(&entry.file), &entry.verification)));
    let second: BTreeMap<String, String> = pairs
        .into_iter()
        .map(|(one, other)| (other.display().to_string(), one.display().to_string()))
        .collect();
    entries.retain(|entry| !second.contains_key(&entry.file));
    refused.extend(second.into_iter().map(|(other, one)| {
        let reason = format!(
            "it and {one} are one run under two names: the same calls and words in every episode. Which was first no file can tell"
        );
        (other, reason)
    }));
}

/// Bundles that can be compared: the same tasks, seeds, profile, skills and preset. Best first.
fn boards(entries: &[Entry]) -> Vec<Vec<&Entry>> {
    let mut boards: BTreeMap<String, Vec<&Entry>> = BTreeMap::new();
    for entry in entries {
        let settings = &entry.manifest.settings;
        let key = json!([
            entry.manifest.grid,
            settings.profile,
            settings.skills,
            settings.preset
        ]);
        boards
            .entry(Digest::of_json(&key).to_string())
            .or_default()
            .push(entry);
    }
    let mut boards: Vec<Vec<&Entry>> = boards.into_values().collect();
    for board in &mut boards {
        board.sort_by(|one, other| order(one, other).then(one.file.cmp(&other.file)));
    }
    boards.sort_by_key(|board| std::cmp::Reverse(board.len()));
    boards
}

/// The better result first.
fn order(one: &Entry, other: &Entry) -> Ordering {
    let (one, other) = (&one.result, &other.result);
    other
        .success_rate
        .total_cmp(&one.success_rate)
        .then(other.completion.total_cmp(&one.completion))
}

/// The episodes that reached their goal.
fn successes(entry: &Entry) -> BTreeSet<Cell<'_>> {
    let episodes = entry.manifest.episodes.iter();
    let successful = episodes.filter(|episode| episode.success);
    successful.map(ClaimedEpisode::cell).collect()
}

/// A bundle against another of the same grid; episodes that were not played are failures.
fn paired(one: &Entry, other: &Entry) -> Option<Paired> {
    let (one_wins, other_wins) = (successes(one), successes(other));
    let differences: Vec<f64> = one
        .manifest
        .grid
        .cells()
        .map(|cell| {
            f64::from(u8::from(one_wins.contains(&cell)))
                - f64::from(u8::from(other_wins.contains(&cell)))
        })
        .collect();
    let only = |wanted: f64| differences.iter().filter(|value| **value == wanted).count() as f64;
    Some(Paired {
        difference: bootstrap(&differences, SAMPLES, SEED)?,
        p: mcnemar(only(1.0), only(-1.0))?,
    })
}

fn write(
    arguments: &Arguments,
    entries: &[Entry],
    refused: &[(String, String)],
) -> anyhow::Result<()> {
    let out = &arguments.out;
    let player = share::player(arguments.player.as_deref())?;
    let folder = out.join("bundles");
    fs::create_dir_all(&folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    if folder.canonicalize()? == arguments.folder.canonicalize()? {
        bail!(
            "{} is where the pages keep their bundles; hand bundles in at another place",
            folder.display()
        );
    }
    if out.join(RESULTS).exists() {
        without_former(&folder, entries)?;
    }
    for entry in entries {
        fs::copy(arguments.folder.join(&entry.file), folder.join(&entry.file))
            .with_context(|| format!("cannot copy {}", entry.file))?;
    }
    match &player {
        Some(player) => fs::write(out.join("player.html"), player.html())?,
        None => eprintln!(
            "reel: this build has no player, so rows do not open: run `make web` and build again, or name a player's page by --player FILE"
        ),
    }
    let boards = boards(entries);
    let page = page(arguments, &boards, refused, player.is_some());
    fs::write(out.join("index.html"), page)?;
    let rows: Vec<Value> = boards
        .iter()
        .map(|board| board.iter().map(|entry| record(entry)).collect())
        .collect();
    let refused: Vec<Value> = refused
        .iter()
        .map(|(file, reason)| json!({"bundle": file, "reason": reason}))
        .collect();
    let results = json!({"boards": rows, "not_ranked": refused});
    fs::write(out.join(RESULTS), format!("{results:#}\n"))?;
    Ok(())
}

/// Removes what an earlier leaderboard in this place had and this one has not.
fn without_former(folder: &Path, entries: &[Entry]) -> anyhow::Result<()> {
    for found in fs::read_dir(folder)? {
        let path = found?.path();
        let is_bundle = path.extension() == Some(OsStr::new("reel"));
        let is_ranked = |entry: &Entry| path.file_name() == Some(OsStr::new(&entry.file));
        if is_bundle && !entries.iter().any(is_ranked) {
            fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
        }
    }
    Ok(())
}

/// What `results.json` has of a bundle.
fn record(entry: &Entry) -> Value {
    let mut record = json!(entry.verification);
    record["bundle"] = json!(entry.file);
    record
}

fn page(
    arguments: &Arguments,
    boards: &[Vec<&Entry>],
    refused: &[(String, String)],
    opens: bool,
) -> String {
    let title = escaped(&arguments.title);
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{title}</title><style>{STYLE}</style>\n\
         <main><h1>{title}</h1>\n<p class=soft>{} was executed again when this page was made{}, and can be executed again in your browser: open a row.</p>\n",
        match arguments.checks.sample {
            Some(share) => format!(
                "Of every result here a sample of {:.1} % of its episodes",
                100.0 * share
            ),
            None => "Every result here".to_owned(),
        },
        if opens {
            ""
        } else {
            " (this copy has no player: `reel verify` executes the bundles)"
        }
    );
    for board in boards {
        let manifest = &board[0].manifest;
        let settings = &manifest.settings;
        let _ = writeln!(
            html,
            "<h2>{} tasks, {} {}</h2>\n<p class=soft>Profile {}, skills {}, rewards of preset {}; simulator {}.</p>\n\
             <table><tr><th>Rank<th>Result<th>Success<th>95 %<th>Completion<th>Steps<th>Against the one above<th>Executed again<th>Signed by",
            manifest.grid.tasks.len(),
            manifest.grid.seeds.len(),
            if manifest.grid.seeds.len() == 1 {
                "seed"
            } else {
                "seeds"
            },
            settings.profile.as_str(),
            settings.skills.as_str(),
            escaped(&settings.preset),
            manifest.simulator
        );
        let mut rank = 0;
        for (index, entry) in board.iter().enumerate() {
            let above = index.checked_sub(1).map(|above| board[above]);
            // Equal results share their rank.
            if above.is_none_or(|above| order(above, entry) != Ordering::Equal) {
                rank = index + 1;
            }
            row(&mut html, rank, entry, above, opens);
        }
        html.push_str("</table>\n");
    }
    if !refused.is_empty() {
        html.push_str("<h2>Not ranked</h2>\n<ul>\n");
        for (file, reason) in refused {
            let _ = writeln!(html, "<li><b>{}</b>: {}", escaped(file), escaped(reason));
        }
        html.push_str("</ul>\n");
    }
    let _ = writeln!(
        html,
        "<p class=soft>{NOT_PROVEN} Differences are over the same tasks and seeds, with a bootstrap interval and McNemar's exact test.</p></main></html>"
    );
    html
}

fn row(html: &mut String, rank: usize, entry: &Entry, above: Option<&Entry>, opens: bool) {
    let Entry {
        file,
        manifest,
        verification,
        result,
    } = entry;
    let name = format!(
        "{} ({})",
        escaped(&manifest.name),
        escaped(&manifest.settings.policy.name)
    );
    let name = match opens {
        true => format!(
            "<a href=\"player.html#bundles/{}\">{name}</a>",
            escaped(&addressed(file))
        ),
        false => name,
    };
    let percent = |share: f64| 100.0 * share;
    let against = above.and_then(|above| paired(entry, above)).map_or_else(
        String::new,
        |Paired {
             difference: [mean, low, high],
             p,
         }| {
            format!(
                "{:+.1} [{:+.1}, {:+.1}], p = {p:.2}",
                percent(mean),
                percent(low),
                percent(high)
            )
        },
    );
    let (executed, all) = (
        verification.executed.episodes.len(),
        verification.episodes as usize,
    );
    let mut executed = if executed == all {
        format!("all {all}")
    } else {
        format!("{executed} of {all}")
    };
    match result.episodes.saturating_sub(result.played) {
        0 => {}
        left => executed += &format!("; {left} not played, which count as failures"),
    }
    let _ = writeln!(
        html,
        "<tr><td>{rank}<td>{name}<td>{:.1} %<td><svg viewBox=\"0 0 100 10\" width=120 height=12 role=img aria-label=\"{:.1} to {:.1}\"><path d=\"M0 5H100\"/><rect x=\"{:.1}\" width=\"{:.1}\" y=2 height=6 /><circle cx=\"{:.1}\" cy=5 r=3 /></svg> {:.1} to {:.1}<td>{:.1} %<td>{:.1}<td>{against}<td>{executed}<td><code>{}</code>",
        percent(result.success_rate),
        percent(result.success_low),
        percent(result.success_high),
        percent(result.success_low),
        percent(result.success_high - result.success_low),
        percent(result.success_rate),
        percent(result.success_low),
        percent(result.success_high),
        percent(result.completion),
        result.steps,
        escaped(verification.signer.as_deref().unwrap_or("nobody"))
    );
}

/// A file name as it stands in an address.
fn addressed(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte);
    name.bytes()
        .map(|byte| match plain(byte) {
            true => char::from(byte).to_string(),
            false => format!("%{byte:02X}"),
        })
        .collect()
}

const STYLE: &str = ":root{color-scheme:light dark}body{font:15px/1.45 system-ui,sans-serif;margin:0 auto;padding:1rem;max-width:1200px}\
                     .soft{color:light-dark(#5b6470,#9aa4b2)}table{border-collapse:collapse;font-variant-numeric:tabular-nums}td,th{text-align:left;padding:.3rem .8rem .3rem 0;\
                     border-bottom:1px solid light-dark(#d6d9de,#3a3f47)}code{font-size:.8rem;white-space:nowrap}td:nth-child(4){white-space:nowrap}svg path{stroke:currentColor;stroke-opacity:.25}\
                     svg rect{fill:light-dark(#9db8e8,#3a5a94)}svg circle{fill:light-dark(#1d4ed8,#8ab4ff)}main{overflow-x:auto}";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_leads_to_its_file() {
        assert_eq!(addressed("a b#1.reel"), "a%20b%231.reel");
    }
}
