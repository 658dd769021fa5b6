//! `reel.toml`: values that are typed again and again, found from the working folder upwards.

use std::{
    env,
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use clap::{Arg, Command};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// Name of the file.
const FILE: &str = "reel.toml";
/// Environment variable that names the file, wherever it lies.
const VARIABLE: &str = "REEL_CONFIG";

/// A key of `reel.toml`.
pub struct Key {
    /// Its name in the file.
    pub name: &'static str,
    /// The flag that it stands for.
    flag: &'static str,
    /// Environment variable that wins over the file.
    variable: &'static str,
    /// What it holds, for people.
    meaning: &'static str,
    /// Whether relative values begin at the folder of the file.
    is_path: bool,
}

/// The keys of `reel.toml`.
pub const KEYS: [Key; 6] = [
    Key {
        name: "store",
        flag: "store",
        variable: "REEL_STORE",
        meaning: "text: a folder or s3://bucket/folder",
        is_path: true,
    },
    Key {
        name: "scenes",
        flag: "scene-dir",
        variable: "REEL_SCENES",
        meaning: "list of texts: folders of scene files",
        is_path: true,
    },
    Key {
        name: "assets",
        flag: "assets",
        variable: "REEL_ASSETS",
        meaning: "text: folder of meshes",
        is_path: true,
    },
    Key {
        name: "endpoint",
        flag: "endpoint",
        variable: "REEL_ENDPOINT",
        meaning: "text: address of an OpenAI-compatible endpoint, up to /v1",
        is_path: false,
    },
    Key {
        name: "model",
        flag: "model",
        variable: "REEL_MODEL",
        meaning: "text: name of a model at the endpoint",
        is_path: false,
    },
    Key {
        name: "api_key_env",
        flag: "api-key-env",
        variable: "REEL_API_KEY_ENV",
        meaning: "text: environment variable that holds the endpoint's key",
        is_path: false,
    },
];

/// Keys of the configuration of `reel serve`, by which its file is recognised.
const SERVER_KEYS: [&str; 9] = reel_world::words! {
    listen data definitions tokens hosts origins log play limits
};

/// Commands that ask a model by default; the others ask one only with `--model`.
const ASKING: [&str; 2] = ["bench", "judge"];
/// Commands with a configuration file of their own.
const SERVING: [&str; 2] = ["serve", "mcp"];

/// The values that stand where no flag is given.
#[derive(Default)]
pub struct Settings {
    /// The file that was read.
    pub file: Option<PathBuf>,
    /// A configuration of `reel serve` that `REEL_CONFIG` names, as it did up to version 0.1.
    server: Option<PathBuf>,
    /// The values of each key, and where they come from.
    values: Vec<(&'static str, Vec<String>, String)>,
}

impl Settings {
    /// The values of the environment and of the nearest `reel.toml`.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has a key or value that is not allowed.
    pub fn load() -> anyhow::Result<Self> {
        let mut settings = Self::default();
        let named = env::var_os(VARIABLE).map(PathBuf::from);
        let here = env::current_dir().context("cannot tell the working folder")?;
        let nearest = || {
            here.ancestors()
                .map(|folder| folder.join(FILE))
                .find(|file| file.is_file())
        };
        if let Some(file) = named.clone().or_else(nearest) {
            let text = fs::read_to_string(&file)
                .with_context(|| format!("cannot read {}", file.display()))?;
            if !settings.read(&file, &text, &here)? {
                let name = file.display();
                eprintln!(
                    "reel: {name} is a configuration of `reel serve`: name it with --config or REEL_SERVE_CONFIG"
                );
                settings.server = named;
            }
        }
        for key in &KEYS {
            if let Some(value) = env::var(key.variable)
                .ok()
                .filter(|value| !value.is_empty())
            {
                let value = if key.name == "scenes" {
                    value.split(',').map(str::to_owned).collect()
                } else {
                    vec![value]
                };
                settings.values.retain(|(name, ..)| *name != key.name);
                settings
                    .values
                    .push((key.name, value, format!("environment {}", key.variable)));
            }
        }
        Ok(settings)
    }

    /// Reads a file; false if it is a configuration of `reel serve`.
    fn read(&mut self, file: &Path, text: &str, here: &Path) -> anyhow::Result<bool> {
        let name = file.display();
        let table = DeTable::parse(text)
            .with_context(|| name.to_string())?
            .into_inner();
        if table
            .keys()
            .any(|key| SERVER_KEYS.contains(&key.get_ref().as_ref()))
        {
            return Ok(false);
        }
        for (typed, value) in &table {
            let line = 1 + text[..typed.span().start].matches('\n').count();
            let Some(key) = KEYS.iter().find(|key| key.name == typed.get_ref()) else {
                let names = KEYS.map(|key| key.name).join(", ");
                bail!(
                    "{name}:{line}: no key is called '{}'; allowed are {names}",
                    typed.get_ref()
                );
            };
            let Some(values) = texts(value, key.name == "scenes") else {
                bail!("{name}:{line}: {} must be a {}", key.name, key.meaning);
            };
            let folder = file
                .parent()
                .filter(|folder| *folder != here && key.is_path);
            let placed = |text: String| match folder {
                Some(folder) if !text.contains("://") => folder.join(text).display().to_string(),
                _ => text,
            };
            let values = values.into_iter().map(placed).collect();
            self.values
                .push((key.name, values, format!("{name}:{line}")));
        }
        self.file = Some(file.to_owned());
        Ok(true)
    }

    /// The values of a key and where they come from, if there are any.
    pub fn get(&self, name: &str) -> Option<(&[String], &str)> {
        let found = self.values.iter().find(|(key, ..)| *key == name)?;
        Some((&found.1, &found.2))
    }

    /// The parser, in which these values are the defaults of their flags.
    pub fn apply(&self, command: Command) -> Command {
        if SERVING.contains(&command.get_name()) {
            return match &self.server {
                Some(file) => command.mut_arg("config", |arg| arg.default_value(leaked(file))),
                None => command,
            };
        }
        let asks = ASKING.contains(&command.get_name());
        command
            .mut_args(|arg| self.with_default(arg, asks))
            .mut_subcommands(|command| self.apply(command))
    }

    fn with_default(&self, arg: Arg, asks: bool) -> Arg {
        let Some(key) = KEYS.iter().find(|key| arg.get_long() == Some(key.flag)) else {
            return arg;
        };
        // `--store` without a default chooses what a command does, as `--model` does where the
        // rules stand in for a model.
        let chooses = match key.name {
            "store" => arg.get_default_values().is_empty(),
            "model" => !asks,
            _ => false,
        };
        match self.get(key.name) {
            Some((values, _)) if !chooses => arg.default_values(values.iter().map(leaked)),
            _ => arg,
        }
    }
}

/// Text of the command line's parser, which takes it for as long as the program runs.
fn leaked(text: impl AsRef<OsStr>) -> &'static OsStr {
    Box::leak(text.as_ref().to_owned().into_boxed_os_str())
}

/// The texts of a value, several only where a list is allowed.
fn texts(value: &Spanned<DeValue<'_>>, list: bool) -> Option<Vec<String>> {
    match value.get_ref() {
        DeValue::String(text) => Some(vec![text.to_string()]),
        DeValue::Array(all) if list => {
            let texts = all
                .iter()
                .map(|value| Some(value.get_ref().as_str()?.to_owned()));
            texts.collect()
        }
        _ => None,
    }
}
