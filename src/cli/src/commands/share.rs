//! `reel share`: an episode as one page that executes it again in any browser.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;
use reel_replay::{RepackError, compact, verify_trace};
use reel_trace::{Trace, trace_stem};
use reel_view::{EmbeddedEpisode, PlayerPage};

use crate::{ExitStatus, inputs};

/// Write an episode as one web page with the simulator in it. Whoever opens it, from disk and
/// without a network, sees the episode executed again and compared with its record, looks at it
/// from any camera, and tries other calls. Images are left out where they can be drawn again.
///
/// Examples:
///   reel share traces/FDP_home_0001--oracle--0.mcap --out episode.html
///   reel share packed.mcap#12 --out episode.html
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trace of the episode
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    #[command(flatten)]
    assets: inputs::Assets,
    /// The page to write
    #[arg(long, value_name = "FILE", default_value = "episode.html")]
    out: PathBuf,
    /// Keep the recorded images in it, so that they are compared too
    #[arg(long)]
    images: bool,
    /// The player's page, as `make web` writes it, instead of the one in this build
    #[arg(long, value_name = "FILE")]
    player: Option<PathBuf>,
}

/// Writes the page; exit code 1 where the episode does not replay exactly here.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let player = player(arguments.player.as_deref())?.context(
        "this build has no player: run `make web` and build again, or name a player's page by --player FILE",
    )?;
    let files = arguments.assets.trace_files()?;
    let trace = files.with_meshes(files.read(&arguments.trace)?);
    let verdict = verify_trace(&trace);
    let bytes = if arguments.images {
        files.bytes(&arguments.trace)?
    } else {
        let part = arguments.out.with_extension("mcap.part");
        let lean = lean(&trace, &part).context("--images keeps the images")?;
        lean.map_or_else(|| files.bytes(&arguments.trace), Ok)?
    };
    let name = format!("{}.mcap", trace_stem(&arguments.trace));
    let page = player.with_episode(&EmbeddedEpisode {
        name: &name,
        trace: &bytes,
        calls: None,
    });
    fs::write(&arguments.out, &page)
        .with_context(|| format!("cannot write {}", arguments.out.display()))?;
    println!(
        "{} ({:.1} MB): open it in a browser",
        arguments.out.display(),
        page.len() as f64 / 1e6
    );
    if verdict.is_exact() {
        println!("here it is {verdict}");
        Ok(ExitStatus::Success)
    } else {
        eprintln!("reel: here it is {verdict}; the page will say so too");
        Ok(ExitStatus::CheckFailed)
    }
}

/// The player's page in a file, or the one in this build, where it has one.
pub fn player(path: Option<&Path>) -> anyhow::Result<Option<PlayerPage>> {
    let read = |path: &Path| {
        PlayerPage::read(path).with_context(|| format!("cannot read {}", path.display()))
    };
    path.map_or_else(|| Ok(PlayerPage::embedded()), |path| read(path).map(Some))
}

/// The trace without its images; none where nothing can be executed, so that they cannot be left out. The file
/// `part` is written and removed.
pub fn lean(trace: &Trace, part: &Path) -> anyhow::Result<Option<Vec<u8>>> {
    let written = match compact(trace, part, false) {
        Ok(_) => Some(fs::read(part)),
        Err(RepackError::NotExact { .. }) => None,
        Err(error) => return Err(error).context("cannot leave the images out"),
    };
    let _ = fs::remove_file(part);
    Ok(written.transpose()?)
}
