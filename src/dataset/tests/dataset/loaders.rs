//! The real loaders load what is written, where they are installed (`tests/setup.sh`).

use reel_dataset::{Format, Style};

use crate::whole;

#[test]
fn every_format_is_loaded_by_its_loader() {
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
    let mut command = reel_vectors::script("bash", "loaders/run.sh");
    let said = reel_vectors::run(command.arg(folder.path()));
    assert!(!said.is_empty());
}
