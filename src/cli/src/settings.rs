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

/// The keys of `reel.toml`, with what each holds. The variable `REEL_STORE` wins over `store`.
pub const KEYS: [(&str, &str); 6] = [
    ("store", "text: a folder or s3://bucket/folder"),
    ("scenes", "list of texts: folders of scene files"),
    ("assets", "text: folder of meshes"),
    ("endpoint", "text: address of a model's API, up to /v1"),
    ("model", "text: name of a model at the endpoint"),
    ("api_key_env", "text: variable that holds the API key"),
];
/// Keys whose relative values begin at the folder of the file.
const PATHS: [&str; 3] = ["store", "scenes", "assets"];

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
        for (key, _) in KEYS {
            let variable = format!("REEL_{}", key.to_uppercase());
            let Some(value) = env::var(&variable).ok().filter(|value| !value.is_empty()) else {
                continue;
            };
            let values = match key {
                "scenes" => value.split(',').map(str::to_owned).collect(),
                _ => vec![value],
            };
            settings.values.retain(|(name, ..)| *name != key);
            let origin = format!("environment {variable}");
            settings.values.push((key, values, origin));
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
            let known = KEYS.iter().find(|(key, _)| key == typed.get_ref());
            let Some((key, meaning)) = known.copied() else {
                let (typed, names) = (typed.get_ref(), KEYS.map(|(key, _)| key).join(", "));
                bail!("{name}:{line}: no key is called '{typed}'; allowed are {names}");
            };
            let Some(values) = texts(value, key == "scenes") else {
                bail!("{name}:{line}: {key} must be a {meaning}");
            };
            let folder = file
                .parent()
                .filter(|folder| *folder != here && PATHS.contains(&key));
            let placed = |text: String| match folder {
                Some(folder) if !text.contains("://") => folder.join(text).display().to_string(),
                _ => text,
            };
            let values = values.into_iter().map(placed).collect();
            self.values.push((key, values, format!("{name}:{line}")));
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
        let key = match arg.get_long() {
            Some("scene-dir") => "scenes",
            Some("api-key-env") => "api_key_env",
            Some(flag) => flag,
            None => return arg,
        };
        // `--store` without a default chooses what a command does, as `--model` does where the
        // rules stand in for a model.
        let chooses = match key {
            "store" => arg.get_default_values().is_empty(),
            "model" => !asks,
            _ => false,
        };
        match self.get(key) {
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
