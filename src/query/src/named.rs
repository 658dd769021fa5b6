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
    ($($name:ident)*) => {
        /// Every named query; one that reads another stands after it.
        pub const ALL: &[NamedQuery] = &[
            $(NamedQuery {
                name: stringify!($name),
                sql: include_str!(concat!("../../../queries/", stringify!($name), ".sql")),
            },)*
        ];
    };
}

queries! {
    summary overview quarantined end_reasons benchmark main_results success_intervals real_world
    primitives repeatability oscillations failed_episodes failures hardest_tasks errors
    error_classes questions question_summary user_fidelity answer_fidelity vocabulary_misses rollouts funnel policy_comparison
    regressions flaky_tasks object_confusions receptacle_confusions distractors reward_components
    rescored_rewards graph_events groups group_advantages latency execution longest_episodes
    success_by_budget effort tool_transitions episodes_matching pattern_success
}

/// Former names, which [`by_name`] still takes, each with the present one.
const RENAMED: &[(&str, &str)] = &[
    ("asking", "question_summary"),
    ("asks", "questions"),
    ("compared", "policy_comparison"),
    ("ends", "end_reasons"),
    ("solved_within", "success_by_budget"),
    ("unsteady_tasks", "flaky_tasks"),
];

/// Finds a query by its name, or by the name that it had before.
pub fn by_name(name: &str) -> Option<&'static NamedQuery> {
    let renamed = RENAMED.iter().find(|(former, _)| *former == name);
    let name = renamed.map_or(name, |(_, present)| present);
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
