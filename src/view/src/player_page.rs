//! The player as one file: a page with the simulator as WebAssembly in it, and an episode.

use std::{fs, io, path::Path};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use flate2::{Compression, write::GzEncoder};

/// Where an episode goes in the page, and what every player's page has.
const PLACE: &str = "<!-- episode -->";

/// The page of `web/`, without an episode.
#[derive(Clone, Debug)]
pub struct PlayerPage(String);

impl PlayerPage {
    /// The page that was built into this library; none where `make web` had not built one.
    pub fn embedded() -> Option<Self> {
        Self::of(include_str!(concat!(env!("OUT_DIR"), "/player.html")))
    }

    /// The page in a file, as `make web` writes it.
    ///
    /// # Errors
    /// When it cannot be read, or is another page.
    pub fn read(path: &Path) -> io::Result<Self> {
        let other = || {
            let problem = "it is no player's page; `make web` writes web/dist/player.html";
            io::Error::new(io::ErrorKind::InvalidData, problem)
        };
        Self::of(&fs::read_to_string(path)?).ok_or_else(other)
    }

    /// The page as it is, which opens what is dropped on it, or the file that its address names after `#`.
    pub fn html(&self) -> &str {
        &self.0
    }

    fn of(page: &str) -> Option<Self> {
        page.contains(PLACE).then(|| Self(page.to_owned()))
    }

    /// The page with an episode in it, which it opens at once.
    pub fn with_episode(&self, episode: &EmbeddedEpisode) -> String {
        self.0.replacen(PLACE, &episode.element("episode"), 1)
    }

    /// The page as an element of another document, whose buttons open episodes in it: those with the id
    /// of an episode's element in `data-episode`, once [`OPEN_EPISODES`] runs behind them.
    pub fn element(&self) -> String {
        let content = packed(self.0.as_bytes());
        format!("<script type=\"application/octet-stream\" id=\"player\">{content}</script>")
    }
}

/// A script for a document with [`PlayerPage::element`] and elements of episodes: buttons open the player under
/// themselves.
pub const OPEN_EPISODES: &str = include_str!("open_episodes.js");

/// An episode that lies in a page.
#[derive(Clone, Copy, Debug)]
pub struct EmbeddedEpisode<'a> {
    /// Shown where the trace cannot be read.
    pub name: &'a str,
    /// Bytes of the trace file.
    pub trace: &'a [u8],
    /// Number of calls after which it is shown once it is verified; none for its end.
    pub calls: Option<u32>,
}

impl EmbeddedEpisode<'_> {
    /// The element with this id that holds the episode.
    pub fn element(&self, id: &str) -> String {
        let name = self
            .name
            .replace('&', "&amp;")
            .replace('"', "&quot;")
            .replace('<', "&lt;");
        let calls = self
            .calls
            .map(|calls| format!(" data-calls=\"{calls}\""))
            .unwrap_or_default();
        let content = packed(self.trace);
        format!(
            "<script type=\"application/octet-stream\" id=\"{id}\" data-name=\"{name}\"{calls}>{content}</script>"
        )
    }
}

/// Bytes as a page holds them: gzip in base64.
fn packed(bytes: &[u8]) -> String {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    // a vector takes all that is written to it
    let written = io::Write::write_all(&mut encoder, bytes).and_then(|()| encoder.finish());
    BASE64_STANDARD.encode(written.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_stands_in_its_place_and_its_name_closes_nothing() {
        let page = PlayerPage::of("<main></main><!-- episode --><script></script>").unwrap();
        let episode = EmbeddedEpisode {
            name: "\"><script>.mcap",
            trace: b"trace",
            calls: Some(3),
        };
        let html = page.with_episode(&episode);
        assert!(html.starts_with("<main></main><script type=\"application/octet-stream\" id=\"episode\" data-name=\"&quot;>&lt;script>.mcap\" data-calls=\"3\">H4sI"), "{html}");
        assert!(html.ends_with("</script><script></script>"), "{html}");
    }

    #[test]
    fn another_page_is_refused() {
        assert!(PlayerPage::of("<main></main>").is_none());
    }
}
