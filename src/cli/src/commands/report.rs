//! `reel report`: a store as one HTML file for a paper or a meeting. Everything is in the file, nothing
//! comes from outside; its only script opens the player with an example.

mod summary;

use std::{fmt::Write as _, fs, path::PathBuf};

use anyhow::Context;
use base64::{Engine as _, prelude::BASE64_STANDARD};
use reel_query::{QuerySession, named};
use reel_replay::{Viewpoint, view_at};
use reel_taxonomy::sankey::{Flow, Sankey};
use reel_trace::{Trace, TraceFiles, encode_png};
use reel_view::{EmbeddedEpisode, OPEN_EPISODES, PlayerPage};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde::Deserialize;

use crate::{
    ExitStatus,
    commands::{
        query::rows,
        share::{self, player},
    },
    html::escaped,
    inputs,
};

/// Write one self-contained HTML file about the episodes of a store: a summary in sentences with its
/// evidence, success rates with intervals, reasons of failure, decisive calls, the hardest tasks,
/// and an example of each kind of failure with the frame of its decisive step. Examples that can be executed
/// again have a button which does that in the reader's browser, without a network; the simulator for it
/// adds 3 MB to the file.
///
/// Examples:
///   reel report --store store --out report.html
///   reel report --store store --summary                     # the sentences alone, on standard output
///   reel report --store store --where "policy = 'planner'" --title "The planner" --out planner.html
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    assets: inputs::Assets,
    /// The file to write
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// Title at the head of the report
    #[arg(long, default_value = "Episodes and why they failed")]
    title: String,
    /// Condition in SQL on the columns of `episodes`; others are left out
    #[arg(long = "where", value_name = "SQL", default_value = "true")]
    condition: String,
    /// Print the summary in sentences, each with up to three traces, and write no file
    #[arg(long)]
    summary: bool,
    /// Print the summary as JSON, one statement a line
    #[arg(long, requires = "summary")]
    json: bool,
    /// Maximum number of failure examples, the most frequent kinds first
    #[arg(long, value_name = "N", default_value_t = 8)]
    examples: usize,
    /// Leave the player out, so that examples are an image and words
    #[arg(long)]
    no_player: bool,
    /// The player's page, as `make web` writes it, instead of the one in this build
    #[arg(long, value_name = "FILE", conflicts_with = "no_player")]
    player: Option<PathBuf>,
    /// The store as it was at this version
    #[arg(long = "store-version", alias = "at", value_name = "N")]
    at: Option<u64>,
}

#[derive(Deserialize)]
struct Rate {
    policy: String,
    family: String,
    episodes: u64,
    won: u64,
    success: f64,
    low: f64,
    high: f64,
    completion: Option<f64>,
    spl: Option<f64>,
    length: Option<f64>,
}

#[derive(Deserialize)]
struct Kind {
    family: String,
    class: String,
    sub_class: String,
    episodes: u64,
}

#[derive(Deserialize)]
struct Cause {
    policy: String,
    episodes: u64,
    perception: f64,
    communication: f64,
    memory: f64,
    primitive: f64,
    other: f64,
}

/// How many episodes are in no rate.
#[derive(Deserialize)]
struct NotJudged {
    episodes: u64,
}

#[derive(Deserialize)]
struct Hard {
    task_id: String,
    family: String,
    instruction: String,
    episodes: u64,
    won: u64,
}

#[derive(Deserialize)]
struct Example {
    class: String,
    sub_class: String,
    alike: u64,
    policy: String,
    task_id: String,
    instruction: String,
    trace: String,
    step: i64,
    explanation: Option<String>,
    advised_call: Option<String>,
}

/// Writes the HTML report of a store and prints its path.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let store = arguments.assets.store(&arguments.store, arguments.at)?;
    let version = store.version();
    let session = QuerySession::new(store)?;
    if arguments.summary {
        let statements = summary::statements(&session, &arguments.episodes())?;
        anyhow::ensure!(!statements.is_empty(), "{}", arguments.nothing());
        for statement in statements {
            if arguments.json {
                println!("{}", serde_json::to_string(&statement)?);
                continue;
            }
            println!("{}", statement.sentence);
            for trace in &statement.traces {
                println!("    {trace}");
            }
        }
        return Ok(ExitStatus::Success);
    }
    let html = page(&session, arguments, version)?;
    fs::write(&arguments.out, html)
        .with_context(|| format!("cannot write {}", arguments.out.display()))?;
    println!("{}", arguments.out.display());
    Ok(ExitStatus::Success)
}

impl Arguments {
    fn nothing(&self) -> String {
        let condition = if self.condition == "true" {
            ""
        } else {
            " that fits --where"
        };
        format!(
            "it is known of no episode of {}{condition} whether it succeeded",
            self.store
        )
    }

    /// The episodes of the report, as a table expression in SQL.
    fn episodes(&self) -> String {
        format!("(SELECT * FROM episodes WHERE ({}\n))", self.condition)
    }
}

fn page(session: &QuerySession, arguments: &Arguments, version: u64) -> anyhow::Result<String> {
    let these = arguments.episodes();
    let rates: Vec<Rate> = rows(session, &rates_sql(&these))?;
    anyhow::ensure!(!rates.is_empty(), "{}", arguments.nothing());
    let kinds: Vec<Kind> = rows(
        session,
        &format!(
            "SELECT family, coalesce(c.class, 'not classified') AS class, coalesce(c.sub_class, '-') AS sub_class, count(*) AS episodes \
         FROM {these} e LEFT JOIN classes c USING (episode_id) WHERE NOT success GROUP BY 1, 2, 3 ORDER BY 4 DESC, 1, 2, 3"
        ),
    )?;
    let causes: Vec<Cause> = rows(
        session,
        &format!(
            "SELECT policy, count(*) AS episodes, sum(perception) AS perception, sum(communication) AS communication, \
         sum(memory) AS memory, sum(primitive) AS primitive, sum(other) AS other FROM {these} e JOIN blame USING (episode_id) WHERE NOT success GROUP BY 1 ORDER BY 1"
        ),
    )?;
    let hard: Vec<Hard> = rows(
        session,
        &format!(
            "SELECT task_id, min(family) AS family, min(instruction) AS instruction, count(*) AS episodes, \
         count(*) FILTER (WHERE success) AS won FROM {these} WHERE success IS NOT NULL GROUP BY task_id \
         HAVING count(*) > count(*) FILTER (WHERE success) ORDER BY 1.0 * count(*) FILTER (WHERE success) / count(*), 4 DESC, 1 LIMIT 12"
        ),
    )?;
    let examples: Vec<Example> = rows(
        session,
        &format!(
            "SELECT class, sub_class, alike, policy, task_id, instruction, trace, step, explanation, advised_call FROM (\
           SELECT c.class, c.sub_class, e.policy, e.task_id, e.instruction, e.trace, coalesce(b.step, c.step) AS step, b.explanation, b.advised_call, \
             count(*) OVER (PARTITION BY c.class, c.sub_class) AS alike, \
             row_number() OVER (PARTITION BY c.class, c.sub_class ORDER BY e.length, e.episode_id) AS place \
           FROM {these} e JOIN classes c USING (episode_id) LEFT JOIN blame b USING (episode_id) WHERE NOT e.success\
         ) WHERE place = 1 ORDER BY alike DESC, class, sub_class LIMIT {}",
            arguments.examples
        ),
    )?;

    let not_judged: Vec<NotJudged> = rows(
        session,
        &format!(
            "SELECT count(*) AS episodes FROM {these} WHERE success IS NULL AND end_reason IS NOT NULL"
        ),
    )?;
    let not_judged: u64 = not_judged.iter().map(|row| row.episodes).sum();

    let title = escaped(&arguments.title);
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{title}</title><style>{STYLE}</style>\n<main><h1>{title}</h1>\n"
    );
    let all = rates.iter().filter(|rate| rate.family == "all");
    let (episodes, won) = all.fold((0, 0), |(episodes, won), rate| {
        (episodes + rate.episodes, won + rate.won)
    });
    let policies = rates.iter().filter(|rate| rate.family == "all").count();
    let _ = writeln!(
        html,
        "<p class=soft>{episodes} episodes of {policies} {}, {won} of them successful{}; version {version} of the tables{}.</p>",
        if policies == 1 { "policy" } else { "policies" },
        if not_judged == 0 {
            String::new()
        } else {
            format!("; {not_judged} more of which nobody told whether they succeeded")
        },
        if arguments.condition == "true" {
            String::new()
        } else {
            format!(", where <code>{}</code>", escaped(&arguments.condition))
        }
    );
    html.push_str("<h2>In short</h2>\n<ul>\n");
    for summary::Statement {
        sentence, traces, ..
    } in summary::statements(session, &these)?
    {
        let traces: Vec<String> = traces
            .iter()
            .map(|trace| format!("<code>{}</code>", escaped(trace)))
            .collect();
        let _ = writeln!(
            html,
            "<li>{} <span class=soft>{}</span>",
            escaped(&sentence),
            traces.join(" ")
        );
    }
    html.push_str("</ul>\n<h2>How often they succeed</h2>\n");
    success(&mut html, &rates);
    html.push_str("<h2>Why they fail</h2>\n");
    let failures: u64 = kinds.iter().map(|kind| kind.episodes).sum();
    if failures == 0 {
        html.push_str("<p>No episode failed.</p>\n");
    } else {
        why(&mut html, &kinds, &causes, episodes, won);
        let player = match arguments.no_player {
            true => None,
            false => player(arguments.player.as_deref())?,
        };
        let files = session.store().trace_files();
        examples_of(&mut html, files, &examples, player.as_ref());
    }
    if !hard.is_empty() {
        html.push_str("<h2>The hardest tasks</h2>\n<table><tr><th>task<th>family<th>instruction<th class=n>successes</tr>\n");
        for task in &hard {
            let _ = writeln!(
                html,
                "<tr><td>{}<td>{}<td>{}<td class=n>{}/{}</tr>",
                escaped(&task.task_id),
                escaped(&task.family),
                escaped(&task.instruction),
                task.won,
                task.episodes
            );
        }
        html.push_str("</table>\n");
    }
    html.push_str("<h2>How this was counted</h2>\n<p>SR: share of episodes whose goal held at the end; in brackets Wilson's 95% interval, which takes episodes as independent. CR: share of the goal's conditions that held. SPL: success weighted by path length. Classes by rules over the recorded steps; regrets are decisions lost, measured by planning from each step. Every number can be asked again:</p>\n");
    let _ = writeln!(
        html,
        "<details><summary>the query of the first table</summary><pre>{}</pre></details>",
        escaped(&rates_sql(&these))
    );
    if let Some(query) = named::by_name("failures") {
        let _ = writeln!(
            html,
            "<details><summary>named query <code>failures</code></summary><pre>{}</pre></details>",
            escaped(query.sql)
        );
    }
    html.push_str("</main></html>\n");
    Ok(html)
}

fn rates_sql(these: &str) -> String {
    format!(
        "SELECT policy, coalesce(family, 'all') AS family, count(*) AS episodes, count(*) FILTER (WHERE success) AS won, \
         avg(CAST(success AS DOUBLE)) AS success, wilson_low(count(*) FILTER (WHERE success), count(*)) AS low, \
         wilson_high(count(*) FILTER (WHERE success), count(*)) AS high, avg(completion) AS completion, avg(spl) AS spl, \
         avg(CAST(length AS DOUBLE)) AS length FROM {these} WHERE success IS NOT NULL \
         GROUP BY GROUPING SETS ((policy, family), (policy)) \
         ORDER BY policy, CASE family WHEN 'FDP' THEN 1 WHEN 'FODP' THEN 2 WHEN 'FDO' THEN 3 WHEN 'SUL' THEN 4 ELSE 5 END"
    )
}

/// Rates as a table, each with its interval drawn on one scale.
fn success(html: &mut String, rates: &[Rate]) {
    html.push_str("<table><tr><th>policy<th>family<th class=n>episodes<th class=n>SR<th>0% to 100%, with the 95% interval<th class=n>CR<th class=n>SPL<th class=n>calls</tr>\n");
    for rate in rates {
        let x = |share: f64| 4.0 + 192.0 * share;
        let bar = format!(
            "<svg width=200 height=14 role=img aria-label=\"{:.0}% to {:.0}%\"><line x1=4 x2=196 y1=7 y2=7 stroke=\"#ddd\"/><line x1={:.1} x2={:.1} y1=7 y2=7 stroke=\"#1f6660\" stroke-width=3 /><circle cx={:.1} cy=7 r=4.5 fill=\"#1f6660\"/></svg>",
            100.0 * rate.low,
            100.0 * rate.high,
            x(rate.low),
            x(rate.high),
            x(rate.success)
        );
        let share = |value: Option<f64>| {
            value.map_or_else(|| "–".to_owned(), |value| format!("{value:.2}"))
        };
        let _ = writeln!(
            html,
            "<tr{}><td>{}<td>{}<td class=n>{}<td class=n>{:.1}% [{:.1}, {:.1}]<td>{bar}<td class=n>{}<td class=n>{}<td class=n>{}</tr>",
            if rate.family == "all" {
                " class=all"
            } else {
                ""
            },
            escaped(&rate.policy),
            escaped(&rate.family),
            rate.episodes,
            100.0 * rate.success,
            100.0 * rate.low,
            100.0 * rate.high,
            share(rate.completion),
            share(rate.spl),
            rate.length
                .map_or_else(|| "–".to_owned(), |length| format!("{length:.1}"))
        );
    }
    html.push_str("</table>\n");
}

fn why(html: &mut String, kinds: &[Kind], causes: &[Cause], episodes: u64, won: u64) {
    let flows: Vec<Flow> = kinds
        .iter()
        .map(|kind| Flow {
            family: kind.family.clone(),
            class: kind.class.clone(),
            sub_class: kind.sub_class.clone(),
            episodes: kind.episodes,
        })
        .collect();
    let image = Sankey::new(
        "Family, class and sub-class of the failures",
        "",
        &flows,
        episodes,
        won,
    )
    .svg();
    let _ = writeln!(html, "<figure>{image}</figure>");
    if causes.is_empty() {
        html.push_str("<p class=soft>What lost the episodes was not measured: <code>reel blame --store</code> does.</p>\n");
        return;
    }
    html.push_str("<h3>What was lost, by cause</h3>\n<table><tr><th>policy<th class=n>failures<th class=n>perception<th class=n>communication<th class=n>memory<th class=n>primitive<th class=n>other</tr>\n");
    for cause in causes {
        let known = cause.perception + cause.communication + cause.memory;
        let total = (known + cause.primitive + cause.other).max(f64::MIN_POSITIVE);
        let share = |value: f64| format!("{:.0}%", 100.0 * value / total);
        let _ = writeln!(
            html,
            "<tr><td>{}<td class=n>{}<td class=n>{}<td class=n>{}<td class=n>{}<td class=n>{}<td class=n>{}</tr>",
            escaped(&cause.policy),
            cause.episodes,
            share(cause.perception),
            share(cause.communication),
            share(cause.memory),
            share(cause.primitive),
            share(cause.other)
        );
    }
    html.push_str("</table>\n");
}

fn examples_of(
    html: &mut String,
    files: &TraceFiles,
    examples: &[Example],
    player: Option<&PlayerPage>,
) {
    if examples.is_empty() {
        html.push_str("<p class=soft>The failures are not classified: <code>reel taxonomy --store</code> does that.</p>\n");
        return;
    }
    html.push_str("<h3>An example of each</h3>\n<div class=examples>\n");
    let mut embedded = Vec::new();
    for (number, example) in examples.iter().enumerate() {
        let trace = files.read(example.trace.as_ref()).ok();
        let before = u32::try_from(example.step)
            .ok()
            .and_then(|step| step.checked_sub(1));
        let image = trace.as_ref().and_then(|trace| image(trace, before)).map_or_else(
            || "<p class=soft>no image: the trace is not where the tables say, or cannot be executed</p>".to_owned(),
            |png| {
                format!(
                    "<img alt=\"what the robot saw before step {}\" src=\"data:image/png;base64,{}\">",
                    example.step,
                    BASE64_STANDARD.encode(png)
                )
            },
        );
        let name = example
            .trace
            .rsplit(['/', '\\'])
            .next()
            .unwrap_or(&example.trace)
            .trim_end_matches(".mcap");
        let id = format!("episode-{number}");
        let element = trace.as_ref().filter(|_| player.is_some());
        let element = element.and_then(|trace| embed(trace, name, before, &id));
        let button = match &element {
            Some(_) => format!("<p><button data-episode={id}>Execute it again here</button></p>"),
            None => String::new(),
        };
        embedded.extend(element);
        let advice = example
            .advised_call
            .as_deref()
            .map_or_else(String::new, |advice| {
                format!("<p><b>Better:</b> {}</p>", escaped(advice))
            });
        let _ = writeln!(
            html,
            "<article>{image}<h4>{}: {} <span class=soft>({})</span></h4><p>{}</p><p>{}</p>{advice}<p class=soft>{}, {}, step {}: <code>{}</code></p>{button}</article>",
            escaped(&example.class),
            escaped(&example.sub_class.replace('_', " ")),
            example.alike,
            escaped(&example.instruction),
            escaped(
                example
                    .explanation
                    .as_deref()
                    .unwrap_or("not measured: `reel blame --store` says what this step lost")
            ),
            escaped(&example.policy),
            escaped(&example.task_id),
            example.step,
            escaped(name)
        );
    }
    html.push_str("</div>\n");
    if let Some(player) = player.filter(|_| !embedded.is_empty()) {
        let _ = writeln!(
            html,
            "{}\n{}\n<script>{OPEN_EPISODES}</script>",
            embedded.join("\n"),
            player.element()
        );
    }
}

/// The example's episode for the player, which shows what the decisive step began with; none where it
/// cannot be executed again, or a browser does not have its meshes.
fn embed(trace: &Trace, name: &str, before: Option<u32>, id: &str) -> Option<String> {
    if !trace.header.meshes.is_empty() {
        return None;
    }
    let folder = tempfile::tempdir().ok()?;
    let trace = share::lean(trace, &folder.path().join("lean.mcap")).ok()??;
    let episode = EmbeddedEpisode {
        name: &format!("{name}.mcap"),
        trace: &trace,
        calls: before.map(|call| call + 1).or(Some(0)),
    };
    Some(episode.element(id))
}

/// What the robot saw before a step: as recorded, else drawn by going there.
fn image(trace: &Trace, before: Option<u32>) -> Option<Vec<u8>> {
    let recorded = trace.frame_rgb(before).ok().flatten();
    let rgb = recorded.or_else(|| {
        view_at(trace, before, &Viewpoint::Head, None)
            .ok()
            .map(|frame| frame.rgb)
    })?;
    Some(encode_png(&rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32))
}

const STYLE: &str = "body{margin:0;background:#fbfaf7;color:#1d2226;font:15px/1.5 system-ui,sans-serif}main{max-width:1080px;margin:0 auto;padding:32px 24px 64px}\
h1{font-size:1.7rem;margin:0 0 4px}h2{margin:36px 0 10px;font-size:1.2rem}h3{margin:24px 0 8px;font-size:1rem}h4{margin:8px 0 4px}\
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{padding:4px 10px;text-align:left;border-bottom:1px solid #dcd8ce;vertical-align:top}\
th{color:#565f66;font-size:.85rem}.n{text-align:right;white-space:nowrap}.all td{font-weight:600}.soft{color:#565f66}\
figure{margin:0}figure svg{max-width:100%;height:auto}.examples{display:grid;grid-template-columns:repeat(auto-fill,minmax(320px,1fr));gap:20px}\
article{background:#fff;border:1px solid #dcd8ce;border-radius:8px;padding:12px;overflow-wrap:anywhere}article img{width:100%;border-radius:4px}article p{margin:4px 0}\
article.open{grid-column:1/-1}article.open img{max-width:320px}iframe{width:100%;height:860px;border:0}\
@media(max-width:700px){main{padding:16px 12px 32px}main>table{display:block;overflow-x:auto}code{overflow-wrap:anywhere}}code,pre{font-family:ui-monospace,monospace;font-size:.88em}pre{white-space:pre-wrap}@media print{main{max-width:none}article{break-inside:avoid}}";
