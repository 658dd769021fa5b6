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

    /// The page with a trace in it, which it opens at once. `name` is shown where the trace cannot
    /// be read.
    ///
    /// # Errors
    /// Never where there is memory.
    pub fn with_episode(&self, name: &str, trace: &[u8]) -> io::Result<String> {
        let mut packed = GzEncoder::new(Vec::new(), Compression::best());
        io::Write::write_all(&mut packed, trace)?;
        let content = BASE64_STANDARD.encode(packed.finish()?);
        let name = name
            .replace('&', "&amp;")
            .replace('"', "&quot;")
            .replace('<', "&lt;");
        let element = format!(
            "<script type=\"application/octet-stream\" id=\"episode\" data-name=\"{name}\">{content}</script>"
        );
        Ok(self.0.replacen(PLACE, &element, 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_stands_in_its_place_and_its_name_closes_nothing() {
        let page = PlayerPage::of("<main></main><!-- episode --><script></script>").unwrap();
        let html = page.with_episode("\"><script>.mcap", b"trace").unwrap();
        assert!(html.starts_with("<main></main><script type=\"application/octet-stream\" id=\"episode\" data-name=\"&quot;>&lt;script>.mcap\">H4sI"), "{html}");
        assert!(html.ends_with("</script><script></script>"), "{html}");
    }

    #[test]
    fn another_page_is_refused() {
        assert!(PlayerPage::of("<main></main>").is_none());
    }
}
