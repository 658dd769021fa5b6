//! `reel query`: SQL over a store.

use std::{
    collections::BTreeMap,
    fs,
    io::{ErrorKind, Write as _},
    path::PathBuf,
    sync::mpsc,
    time::Duration,
};

use anyhow::{Context, anyhow, bail};
use reel_query::{
    Format, Limits, Parameters, QueryError, QuerySession, SetLimit, StopReason, arrow_file, format,
    named, parquet_file,
};

use crate::{ExitStatus, cluster_arguments::ClusterArguments, cost::Cost, inputs, progress};

/// Query a store in SQL, by text or by the name of a query. Every named query is a view too. Functions of
/// Reel's own work on the steps of an episode and call the simulator: `reel query --functions`.
///
/// Examples:
///   reel query --store store --named benchmark
///   reel query --store store --named regressions --param a=oracle --param b=no-ask
///   reel query --store store "SELECT policy, count(*) FROM episodes WHERE NOT success GROUP BY policy"
///   reel query --store store "SELECT count(*) FROM episodes WHERE sequence_match(steps, '^ !ask* pick[not goal_object]')"
///   reel query --store store "SELECT family, count(*) FROM episodes WHERE replay(trace).verdict = 'exact' GROUP BY family"
///   reel query --list
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// SQL text to run, instead of --file or --named
    #[arg(value_name = "SQL", conflicts_with_all = ["named", "file"])]
    sql: Option<String>,
    /// File with the SQL text; `-` reads standard input
    #[arg(long, value_name = "FILE", conflicts_with = "named")]
    file: Option<PathBuf>,
    /// Name of a query that comes with Reel
    #[arg(long, value_name = "NAME")]
    named: Option<String>,
    /// Value of a `$parameter` of the query; may be given several times
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = parameter)]
    parameters: Vec<(String, String)>,
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    assets: inputs::Assets,
    /// The store as it was at this version (`reel store history`)
    #[arg(long = "store-version", alias = "at", value_name = "N")]
    at: Option<u64>,
    #[command(flatten)]
    in_cluster: ClusterArguments,
    /// table, csv, json, arrow (IPC file) or parquet
    #[arg(long, value_name = "FORMAT", default_value = "table", value_parser = ["table", "csv", "json", "arrow", "parquet"])]
    format: String,
    /// The same as --format json
    #[arg(long)]
    json: bool,
    /// Write the result into this file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Longest time a query may take, in seconds
    #[arg(long, value_name = "S", default_value_t = 600, value_parser = clap::value_parser!(u64).range(1..))]
    timeout: u64,
    /// Memory for sorts, joins and aggregations before they spill, in MiB; the process may grow
    /// by four times that
    #[arg(long, value_name = "MIB", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    memory: u32,
    /// Maximum number of rows of a result
    #[arg(long, value_name = "N", default_value_t = 10_000_000)]
    max_rows: usize,
    /// Print on standard error what the query cost: wall and CPU time, memory
    #[arg(long)]
    timing: bool,
    /// With --timing: repeat the query this many times in the same session, and print the cost of
    /// each
    #[arg(long = "repeat", alias = "again", value_name = "N", requires = "timing", value_parser = clap::value_parser!(u32).range(1..))]
    again: Option<u32>,
    /// List the named queries; with --named, print what that one answers
    #[arg(long)]
    list: bool,
    /// List the functions of Reel's own, with examples
    #[arg(long)]
    functions: bool,
}

/// Answers an SQL query over a store, or lists the named queries or functions.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    if arguments.functions {
        for function in reel_query::functions() {
            println!(
                "{}\n    {}\n    {}\n",
                function.call, function.meaning, function.example
            );
        }
        return Ok(ExitStatus::Success);
    }
    if arguments.list {
        match &arguments.named {
            Some(name) => println!("{}", find(name)?.help()),
            None => named::ALL
                .iter()
                .for_each(|query| println!("{:24} {}", query.name, query.summary())),
        }
        return Ok(ExitStatus::Success);
    }
    let mut parameters: Parameters = BTreeMap::new();
    let sql = match (&arguments.sql, &arguments.named, &arguments.file) {
        (Some(sql), ..) => sql.clone(),
        (None, Some(name), _) => {
            let query = find(name)?;
            parameters.extend(query.parameters());
            query.sql.to_owned()
        }
        (None, None, Some(file)) if file.as_os_str() == "-" => {
            std::io::read_to_string(std::io::stdin())?
        }
        (None, None, Some(file)) => {
            fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?
        }
        (None, None, None) => {
            bail!("give SQL text, --file FILE or --named NAME; `reel query --list` lists the names")
        }
    };
    parameters.extend(arguments.parameters.iter().cloned());
    let store = arguments.assets.store(&arguments.store, arguments.at)?;
    let limits = Limits {
        memory_bytes: (arguments.memory as usize) << 20,
        time: Duration::from_secs(arguments.timeout),
        rows: arguments.max_rows,
    };
    let session = arguments.in_cluster.session(store, limits)?;
    let ask = || match watched(&session, || session.run_with(&sql, &parameters)) {
        Err(QueryError::Stopped(StopReason::Cancelled)) => {
            eprintln!("reel: {}", StopReason::Cancelled);
            std::process::exit(130);
        }
        answer => answer.map_err(advised),
    };
    let cost = Cost::of(1);
    let batches = ask()?;
    if arguments.timing {
        eprintln!("answered in {cost}");
    }
    if let Some(rounds) = arguments.again {
        let cost = Cost::of(rounds);
        for _ in 0..rounds {
            ask()?;
        }
        eprintln!("again in {cost} (mean of {rounds})");
    }
    let bytes = match arguments.format.as_str() {
        _ if arguments.json => format(&batches, Format::Json)?.into_bytes(),
        "csv" => format(&batches, Format::Csv)?.into_bytes(),
        "json" => format(&batches, Format::Json)?.into_bytes(),
        "arrow" => arrow_file(&batches)?,
        "parquet" => parquet_file(&batches)?,
        _ => reel_world::printable_lines(&format(&batches, Format::Table)?).into_bytes(),
    };
    match &arguments.out {
        Some(path) => {
            fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))?
        }
        None => match std::io::stdout().write_all(&bytes) {
            // as a pipe's writer ends when nobody reads on: 128 + SIGPIPE
            Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(141),
            written => written?,
        },
    }
    Ok(ExitStatus::Success)
}

/// An error with what it is called here that can be changed.
fn advised(error: QueryError) -> anyhow::Error {
    let limit = match &error {
        QueryError::Stopped(reason) => reason.limit(),
        QueryError::Parameter(_) => return anyhow!("{error} (--param NAME=VALUE)"),
        _ => None,
    };
    match limit {
        Some(SetLimit::Time) => anyhow!("{error}, or raise --timeout"),
        Some(SetLimit::Memory) => anyhow!("{error}, or raise --memory"),
        Some(SetLimit::Rows) => anyhow!("{error}, or raise --max-rows"),
        None => error.into(),
    }
}

/// Asks and prints.
///
/// # Errors
/// When the store cannot be opened or the query is wrong.
pub fn print(store: &str, sql: &str, form: Format) -> anyhow::Result<()> {
    let text = format(&reel_query::run(inputs::store(store, None)?, sql)?, form)?;
    println!("{}", text.trim_end());
    Ok(())
}

/// Runs a query while Ctrl-C stops it and a spinner counts the traces that its
/// functions have worked off.
fn watched<T>(session: &QuerySession, run: impl FnOnce() -> T) -> T {
    session.stop_on_ctrl_c();
    let control = session.control();
    let spinner = progress::spinner();
    let (done, ended) = mpsc::channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while ended.recv_timeout(Duration::from_millis(50))
                == Err(mpsc::RecvTimeoutError::Timeout)
            {
                match control.simulated() {
                    0 => {}
                    traces => {
                        spinner.set_message(format!("{traces} traces worked off; Ctrl-C stops"))
                    }
                }
                spinner.tick();
            }
            spinner.finish_and_clear();
        });
        let answer = run();
        drop(done);
        answer
    })
}

fn parameter(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("write NAME=VALUE")?;
    Ok((name.trim_start_matches('$').to_owned(), value.to_owned()))
}

fn find(name: &str) -> anyhow::Result<&'static named::NamedQuery> {
    named::by_name(name).with_context(|| {
        let known: Vec<&str> = named::ALL.iter().map(|query| query.name).collect();
        format!(
            "no query is called '{name}'; there are {}",
            known.join(", ")
        )
    })
}

/// The answer to a question as rows of a type that has its columns.
pub(crate) fn rows<T: serde::de::DeserializeOwned>(
    session: &QuerySession,
    sql: &str,
) -> anyhow::Result<Vec<T>> {
    let text = format(&session.run(sql)?, Format::Json)?;
    serde_json::from_str(&text)
        .with_context(|| format!("an answer has another form than expected: {sql}"))
}
