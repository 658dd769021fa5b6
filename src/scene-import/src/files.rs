//! The files of an import: the one that is named, and those beside and below it that it names.
//! Opens nothing outside of its folder.

use std::path::Path;

pub(crate) use reel_tasks::assets::usd::values::is_sane;
use reel_tasks::assets::{AssetFolder, SiblingFiles};

use crate::ImportError;

/// Most elements and attributes of an XML file.
const XML_NODES_MAX: u32 = 2_000_000;
/// Deepest nesting of an XML or JSON file.
pub(crate) const DEPTH_MAX: usize = 100;

/// A file to import, and the folder that it may name files of.
pub(crate) struct ImportFiles {
    folder: AssetFolder,
    /// Name of the file to import, within its folder.
    pub(crate) name: String,
}

impl ImportFiles {
    pub(crate) fn beside(path: &Path) -> Result<Self, ImportError> {
        let unreadable = |reason: String| ImportError::Unreadable {
            file: path.display().to_string(),
            reason,
        };
        let name = path.file_name().and_then(|name| name.to_str());
        let name = name.ok_or_else(|| unreadable("its name is no text".to_owned()))?;
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        Ok(Self {
            folder: AssetFolder::open(folder).map_err(|error| unreadable(error.to_string()))?,
            name: name.to_owned(),
        })
    }

    /// The folder of the file.
    pub(crate) fn folder(&self) -> &AssetFolder {
        &self.folder
    }

    /// The bytes of a file of the folder.
    pub(crate) fn bytes(&self, name: &str) -> Result<Vec<u8>, ImportError> {
        self.folder
            .read(name)
            .map_err(|error| ImportError::Unreadable {
                file: name.chars().take(200).collect(),
                reason: error.to_string(),
            })
    }

    /// Whether there is such a file in the folder.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.folder.read(name).is_ok()
    }

    pub(crate) fn text(&self, name: &str) -> Result<String, ImportError> {
        String::from_utf8(self.bytes(name)?).map_err(|error| ImportError::Unreadable {
            file: name.to_owned(),
            reason: format!(
                "byte {} is not UTF-8: it is no text",
                error.utf8_error().valid_up_to()
            ),
        })
    }
}

/// Parses XML with limits on its size and depth. Entities that a file declares are refused.
pub(crate) fn parse_xml<'a>(
    text: &'a str,
    file: &str,
) -> Result<roxmltree::Document<'a>, ImportError> {
    let syntax = |line: usize, problem: String| ImportError::Syntax {
        file: file.to_owned(),
        line,
        problem,
    };
    if let Some(line) = too_deep(text) {
        return Err(syntax(
            line,
            format!("nested deeper than {DEPTH_MAX} elements"),
        ));
    }
    let options = roxmltree::ParsingOptions {
        nodes_limit: XML_NODES_MAX,
        ..Default::default()
    };
    roxmltree::Document::parse_with_options(text, options)
        .map_err(|error| syntax(error.pos().row as usize, error.to_string()))
}

/// The line where tags nest too deep. Counts what looks like a tag, which comments may only make
/// more; the parser would recurse as deep.
fn too_deep(text: &str) -> Option<usize> {
    let bytes = text.as_bytes();
    let (mut depth, mut line) = (0_usize, 1);
    for (at, byte) in bytes.iter().enumerate() {
        match (byte, bytes.get(at + 1)) {
            (b'\n', _) => line += 1,
            (b'<', Some(b'/')) => depth = depth.saturating_sub(1),
            (b'<', Some(next)) if next.is_ascii_alphabetic() => depth += 1,
            (b'/', Some(b'>')) => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > DEPTH_MAX {
            return Some(line);
        }
    }
    None
}

/// The numbers of a text, exactly so many.
pub(crate) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let values = number_list(text)?;
    values.try_into().ok()
}

/// The numbers of a text; `None` where one is no finite number of a sensible size.
pub(crate) fn number_list(text: &str) -> Option<Vec<f64>> {
    let value = |word: &str| word.parse().ok().filter(|value| is_sane(*value));
    text.split_ascii_whitespace().map(value).collect()
}
