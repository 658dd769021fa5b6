//! The named queries of `queries/`, built into the binary. Each file documents itself in its header comment; each query is
//! a view as well, so that others can build upon it.

/// A query with a name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NamedQuery {
    /// Its name: the file's, without `.sql`.
    pub name: &'static str,
    /// The file: a header comment and one statement.
    pub sql: &'static str,
}

macro_rules! queries {
    ($($name:literal),* $(,)?) => {
        /// Every named query; one that reads another stands after it.
        pub const ALL: &[NamedQuery] = &[
            $(NamedQuery { name: $name, sql: include_str!(concat!("../../../queries/", $name, ".sql")) },)*
        ];
    };
}

queries!["benchmark", "main_results", "oscillations", "failed_episodes", "failures", "errors", "reward_components"];

/// Finds a query by its name.
pub fn by_name(name: &str) -> Option<&'static NamedQuery> {
    ALL.iter().find(|query| query.name == name)
}

impl NamedQuery {
    /// The header comment, without the comment marks and the name: what it tells, its columns, an example.
    pub fn help(&self) -> String {
        let header = self.sql.lines().map_while(|line| line.strip_prefix("--"));
        let lines: Vec<&str> = header.skip(2).map(|line| line.strip_prefix(' ').unwrap_or(line)).collect();
        lines.join("\n")
    }

    /// The first sentence of the header.
    pub fn summary(&self) -> String {
        let help = self.help().replace('\n', " ");
        help.split_inclusive([':', '.']).next().unwrap_or_default().trim_end_matches([':', '.']).to_owned()
    }
}
