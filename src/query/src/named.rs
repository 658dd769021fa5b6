//! The named queries of `queries/`, built into the binary. Each file documents itself in its header
//! comment; each query is a view as well, so that others can build upon it.

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

queries![
    "overview",
    "quarantined",
    "ends",
    "benchmark",
    "main_results",
    "success_intervals",
    "real_world",
    "primitives",
    "repeatability",
    "oscillations",
    "failed_episodes",
    "failures",
    "hardest_tasks",
    "errors",
    "error_classes",
    "asks",
    "asking",
    "user_fidelity",
    "rollouts",
    "funnel",
    "compared",
    "regressions",
    "unsteady_tasks",
    "object_confusions",
    "receptacle_confusions",
    "distractors",
    "reward_components",
    "rescored_rewards",
    "graph_events",
    "groups",
    "group_advantages",
    "latency",
    "execution",
    "longest_episodes",
    "solved_within",
    "effort",
    "tool_transitions",
    "episodes_matching",
    "pattern_success",
];

/// Finds a query by its name.
pub fn by_name(name: &str) -> Option<&'static NamedQuery> {
    ALL.iter().find(|query| query.name == name)
}

impl NamedQuery {
    /// The header comment, without the comment marks and the name: what it tells,
    /// its columns, an example.
    pub fn help(&self) -> String {
        let header = self.sql.lines().map_while(|line| line.strip_prefix("--"));
        let lines: Vec<&str> = header
            .skip(2)
            .map(|line| line.strip_prefix(' ').unwrap_or(line))
            .collect();
        lines.join("\n")
    }

    /// Parameters with their defaults, from the lines `$name = default` under
    /// `Parameters:` of the header.
    pub fn parameters(&self) -> Vec<(String, String)> {
        let help = self.help();
        let lines = help
            .lines()
            .skip_while(|line| *line != "Parameters:")
            .skip(1);
        let parameter = |line: &str| {
            let (name, rest) = line.strip_prefix("  $")?.split_once(" = ")?;
            let default = rest.split_once("  ").map_or(rest, |(default, _)| default);
            Some((name.trim().to_owned(), default.trim().to_owned()))
        };
        lines.map_while(parameter).collect()
    }

    /// The text with the defaults in the place of its parameters: a view.
    pub fn with_defaults(&self) -> String {
        let mut sql = self.sql.to_owned();
        for (name, default) in self.parameters() {
            let quoted = default.parse::<f64>().map_or_else(
                |_| format!("'{}'", default.replace('\'', "''")),
                |_| default.clone(),
            );
            sql = sql.replace(&format!("${name}"), &quoted);
        }
        sql
    }

    /// The first sentence of the header.
    pub fn summary(&self) -> String {
        let help = self.help().replace('\n', " ");
        help.split_inclusive([':', '.'])
            .next()
            .unwrap_or_default()
            .trim_end_matches([':', '.'])
            .to_owned()
    }
}
