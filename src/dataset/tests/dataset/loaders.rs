//! The real loaders load what is written, where they are installed (`tests/loaders/install.sh`).

use std::{path::Path, process::Command};

use reel_dataset::{Format, Style};

use crate::whole;

#[test]
fn every_format_is_loaded_by_its_loader() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/loaders/run.sh");
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL
        .into_iter()
        .filter(|format| *format != Format::Parquet)
    {
        for style in [Style::SingleTurn, Style::MultiTurn] {
            whole::write(
                &folder
                    .path()
                    .join(format!("{}-{}", format.as_str(), style.as_str())),
                format,
                style,
            );
        }
    }
    match Command::new("bash")
        .arg(&script)
        .arg(folder.path())
        .output()
    {
        Err(error) => eprintln!("skipped: no bash ({error})"),
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stdout);
            eprintln!("{said}");
            assert!(
                output.status.success(),
                "{said}{}",
                String::from_utf8_lossy(&output.stderr)
            );
            assert!(!said.is_empty());
        }
    }
}
