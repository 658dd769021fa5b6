//! Asks a store in SQL and reads the answer as Arrow.
//!
//! `cargo run -p reel-query --example sql -- demo-out/store`

use std::{env, error::Error};

use arrow::{array::AsArray as _, datatypes::Float64Type};
use reel_query::{Format, QuerySession, format};
use reel_tables::Store;

const SUCCESS_RATE: &str =
    "SELECT policy, avg(success::int) AS rate FROM episodes GROUP BY 1 ORDER BY 1";

fn main() -> Result<(), Box<dyn Error>> {
    let store = env::args().nth(1).ok_or("usage: sql STORE")?;
    let session = QuerySession::new(Store::open(&store)?)?;
    let batches = session.run(SUCCESS_RATE)?;
    print!("{}", format(&batches, Format::Table)?);
    // The same as numbers: columns of Arrow, by name.
    for batch in &batches {
        let rates = batch["rate"].as_primitive::<Float64Type>();
        println!(
            "{} policies, the last at {}",
            rates.len(),
            rates.value(rates.len() - 1)
        );
    }
    Ok(())
}
