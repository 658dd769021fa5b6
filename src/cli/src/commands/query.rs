//! `reel query`: SQL over a store.

use anyhow::{Context, bail};
use reel_query::{Format, format, named};
use reel_tables::Store;

use crate::Answer;

/// Ask a store in SQL, by text or by a named query. Every named query is a view too.
///
/// Examples:
///   reel query --store store --named benchmark
///   reel query --store store "SELECT policy, count(*) FROM episodes WHERE NOT success GROUP BY policy"
///   reel query --list
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// SQL text
    #[arg(value_name = "SQL", conflicts_with = "named")]
    sql: Option<String>,
    /// Name of a query that comes with Reel
    #[arg(long, value_name = "NAME")]
    named: Option<String>,
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// table, csv or json
    #[arg(long, value_name = "FORMAT", default_value = "table", value_parser = ["table", "csv", "json"])]
    format: String,
    /// The same as --format json
    #[arg(long)]
    json: bool,
    /// List the named queries; with --named, print what that one tells
    #[arg(long)]
    list: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    if arguments.list {
        match &arguments.named {
            Some(name) => println!("{}", find(name)?.help()),
            None => named::ALL.iter().for_each(|query| println!("{:18} {}", query.name, query.summary())),
        }
        return Ok(Answer::Yes);
    }
    let sql = match (&arguments.sql, &arguments.named) {
        (Some(sql), _) => sql.as_str(),
        (None, Some(name)) => find(name)?.sql,
        (None, None) => bail!("give SQL text or --named NAME; `reel query --list` lists the names"),
    };
    let form = match arguments.format.as_str() {
        _ if arguments.json => Format::Json,
        "csv" => Format::Csv,
        "json" => Format::Json,
        _ => Format::Table,
    };
    print(&arguments.store, sql, form)?;
    Ok(Answer::Yes)
}

/// Asks and prints.
///
/// # Errors
/// When the store cannot be opened or the query is wrong.
pub fn print(store: &str, sql: &str, form: Format) -> anyhow::Result<()> {
    let store = Store::open(store)?;
    let text = format(&reel_query::run(store, sql)?, form)?;
    println!("{}", text.trim_end());
    Ok(())
}

fn find(name: &str) -> anyhow::Result<&'static named::NamedQuery> {
    named::by_name(name).with_context(|| {
        let known: Vec<&str> = named::ALL.iter().map(|query| query.name).collect();
        format!("no query is called '{name}'; there are {}", known.join(", "))
    })
}
