//! Questions that mean harm: equal seeds give equal questions.

use std::fmt::Write as _;

/// Numbers that look random (xorshift).
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) % bound
    }

    fn one<'a>(&mut self, all: &[&'a str]) -> &'a str {
        all[self.below(all.len() as u64) as usize]
    }

    fn large(&mut self) -> u64 {
        10_u64.pow(3 + self.below(8) as u32)
    }
}

/// The question of a seed.
pub fn question(seed: u64) -> String {
    let mut numbers = Numbers((seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
    let kinds = [
        joins,
        subqueries,
        recursion,
        windows,
        texts,
        arrays,
        expressions,
        patterns,
        sorts,
        nested,
        lists,
        ours,
    ];
    kinds[(seed % kinds.len() as u64) as usize](&mut numbers)
}

fn joins(numbers: &mut Numbers) -> String {
    let count = 2 + numbers.below(40);
    let mut tables = String::new();
    for index in 0..count {
        let comma = if index > 0 { ", " } else { "" };
        let table = numbers.one(&["episodes", "steps", "steps", "objects"]);
        write!(tables, "{comma}{table} t{index}").unwrap();
    }
    let condition = numbers.one(&[
        "",
        " WHERE t0.episode_id < t1.episode_id",
        " WHERE t0.episode_id = t1.episode_id OR t0.task_id <> t1.task_id",
        " WHERE t0.episode_id LIKE concat('%', t1.episode_id, '%')",
    ]);
    let shown = numbers.one(&[
        "count(*)",
        "max(t0.episode_id)",
        "*",
        "count(DISTINCT t1.episode_id)",
    ]);
    format!("SELECT {shown} FROM {tables}{condition}")
}

fn subqueries(numbers: &mut Numbers) -> String {
    let count = 2 + numbers.below(40);
    let join = numbers.one(&["UNION ALL", "UNION", "INTERSECT", "EXCEPT"]);
    let first = numbers.one(&[
        "SELECT 1 AS x UNION ALL SELECT 2",
        "SELECT step AS x FROM steps",
    ]);
    let mut text = format!("WITH c0 AS ({first})");
    for index in 1..count {
        let before = index - 1;
        write!(
            text,
            ", c{index} AS (SELECT x FROM c{before} {join} SELECT x + {index} FROM c{before})"
        )
        .unwrap();
    }
    format!("{text} SELECT sum(x) FROM c{}", count - 1)
}

fn recursion(numbers: &mut Numbers) -> String {
    let large = numbers.large();
    let step = numbers.one(&[
        "SELECT n + 1 FROM r",
        "SELECT n + 1 FROM r UNION ALL SELECT n + 2 FROM r",
        "SELECT r.n + s.step FROM r CROSS JOIN steps s",
        "SELECT a.n + 1 FROM r a JOIN steps s ON s.step >= a.n % 3",
    ]);
    let end = match numbers.below(2) {
        0 => String::new(),
        _ => format!(" WHERE n < {large}"),
    };
    format!(
        "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT * FROM ({step}){end}) SELECT count(*), max(n) FROM r"
    )
}

fn windows(numbers: &mut Numbers) -> String {
    let large = numbers.large();
    let frame = numbers.one(&[
        "ORDER BY value ROWS BETWEEN UNBOUNDED PRECEDING AND UNBOUNDED FOLLOWING",
        "ORDER BY value DESC",
        "PARTITION BY value % 3 ORDER BY value RANGE BETWEEN 1000000 PRECEDING AND CURRENT ROW",
        "ORDER BY value ROWS BETWEEN 100000 PRECEDING AND 100000 FOLLOWING",
    ]);
    let function = numbers.one(&[
        "sum(value)",
        "median(value)",
        "count(value)",
        "array_agg(value)",
        "nth_value(value, 7)",
        "string_agg(CAST(value AS VARCHAR), ',')",
    ]);
    format!(
        "SELECT max(w) FROM (SELECT {function} OVER ({frame}) AS w FROM generate_series(1, {large}))"
    )
}

fn texts(numbers: &mut Numbers) -> String {
    let (count, large) = (1 + numbers.below(130_000), numbers.large());
    let text = format!(
        "repeat('{}', {count})",
        numbers.one(&["a", "ab", "\u{e9}\u{1f600}"])
    );
    let made = match numbers.below(6) {
        0 => format!("levenshtein({text}, repeat('b', {count}))"),
        1 => format!("length(replace({text}, 'a', {text}))"),
        2 => format!("length(concat({}))", vec![text.as_str(); 200].join(", ")),
        3 => format!("length(translate({text}, 'ab', 'ba'))"),
        4 => format!("length(string_agg({text}, ','))"),
        _ => format!("strpos({text}, concat({text}, 'c'))"),
    };
    format!("SELECT {made} FROM generate_series(1, {large})")
}

fn arrays(numbers: &mut Numbers) -> String {
    let (large, count) = (numbers.large(), 1 + numbers.below(20_000));
    let array = format!("range(0, {count})");
    match numbers.below(6) {
        0 => format!("SELECT array_length(array_agg(value)) FROM generate_series(1, {large})"),
        1 => format!(
            "SELECT count(*) FROM (SELECT unnest({array}) AS a FROM generate_series(1, {large}))"
        ),
        2 => format!(
            "SELECT sum(array_length(array_concat({array}, {array}))) FROM generate_series(1, {large})"
        ),
        3 => format!("SELECT max(array_position({array}, value)) FROM generate_series(1, {large})"),
        4 => format!(
            "SELECT count(*) FROM (SELECT unnest(flatten(array_repeat({array}, 6))) FROM generate_series(1, {large}))"
        ),
        _ => format!(
            "SELECT array_length(array_distinct(array_agg(value % 1000000))) FROM generate_series(1, {large})"
        ),
    }
}

fn expressions(numbers: &mut Numbers) -> String {
    let (count, large) = (1 + numbers.below(1_000), numbers.large());
    let pattern = match numbers.below(5) {
        0 => "(a|aa)+$".to_owned(),
        1 => format!("(x{{{count}}}){{{count}}}"),
        2 => format!("^(a?){{{count}}}(a){{{count}}}$"),
        3 => "(.*)*(.*)*(.*)*b".to_owned(),
        _ => format!("(?i)[\\p{{L}}]{{{count}}}"),
    };
    let function = numbers.one(&["regexp_like", "regexp_count", "regexp_instr"]);
    format!(
        "SELECT count({function}(repeat('a', {count}), '{pattern}')) FROM generate_series(1, {large})"
    )
}

fn patterns(numbers: &mut Numbers) -> String {
    let (count, deep) = (1 + numbers.below(60), 1 + numbers.below(6));
    let mut pattern = numbers
        .one(&["nav_to", "_", "(nav_to | pick[ok])", "!place*"])
        .to_owned();
    for _ in 0..deep {
        pattern = format!("({pattern}){{1,{count}}}");
    }
    format!(
        "SELECT count(*) FROM episodes a, episodes b, episodes c WHERE sequence_match(a.steps, '{pattern}')"
    )
}

fn sorts(numbers: &mut Numbers) -> String {
    let large = numbers.large();
    let key = numbers.one(&[
        "random()",
        "md5(CAST(value AS VARCHAR))",
        "value % 7, -value",
        "concat('a text that is kept ', value)",
    ]);
    match numbers.below(4) {
        0 => format!("SELECT * FROM generate_series(1, {large}) ORDER BY {key}"),
        1 => format!(
            "SELECT count(*) FROM (SELECT DISTINCT md5(CAST(value AS VARCHAR)) FROM generate_series(1, {large}))"
        ),
        2 => format!(
            "SELECT md5(CAST(value AS VARCHAR)) AS k, count(*) FROM generate_series(1, {large}) GROUP BY 1 ORDER BY 2 LIMIT 3"
        ),
        _ => format!(
            "SELECT approx_distinct(value), approx_median(value), median(value) FROM generate_series(1, {large})"
        ),
    }
}

fn nested(numbers: &mut Numbers) -> String {
    let deep = 1 + numbers.below(60);
    let mut text = "SELECT episode_id FROM steps".to_owned();
    for level in 0..deep {
        let column = "episode_id";
        let link = numbers.one(&["IN", "NOT IN"]);
        text = format!(
            "SELECT s{level}.{column} FROM steps s{level} WHERE s{level}.{column} {link} ({text})"
        );
    }
    match numbers.below(3) {
        0 => text,
        1 => "SELECT count(*) FROM steps a WHERE EXISTS (SELECT 1 FROM steps b, steps c WHERE b.step + c.step > a.step AND b.episode_id <> c.episode_id)".to_owned(),
        _ => "SELECT (SELECT count(*) FROM steps b, steps c WHERE b.step > a.step) FROM steps a, steps d".to_owned(),
    }
}

fn lists(numbers: &mut Numbers) -> String {
    let count = 1 + numbers.below(20_000);
    let listed = (0..count)
        .map(|value| value.to_string())
        .collect::<Vec<_>>()
        .join(", ");
    match numbers.below(3) {
        0 => format!("SELECT count(*) FROM steps WHERE step IN ({listed})"),
        1 => format!(
            "SELECT count(*) FROM (VALUES {}) v(a)",
            (0..count)
                .map(|value| format!("({value})"))
                .collect::<Vec<_>>()
                .join(", ")
        ),
        _ => {
            let cases = (0..count % 2_000)
                .map(|value| format!(" WHEN {value} THEN {value}"))
                .collect::<String>();
            format!("SELECT CASE step{cases} END FROM steps")
        }
    }
}

fn ours(numbers: &mut Numbers) -> String {
    let large = numbers.large();
    match numbers.below(5) {
        0 => "SELECT replay(a.trace) FROM episodes a, episodes b, episodes c".to_owned(),
        1 => "SELECT blame(a.trace) FROM episodes a, episodes b, episodes c".to_owned(),
        2 => format!(
            "SELECT count(prevailing_tail(e.steps, '[repeated]')) FROM episodes e, generate_series(1, {large})"
        ),
        3 => format!(
            "SELECT count(oscillation(e.steps)) FROM episodes e, generate_series(1, {large})"
        ),
        _ => format!(
            "SELECT count(sequence_count(e.steps, '(_ .. _){{1,8}}')) FROM episodes e, generate_series(1, {large})"
        ),
    }
}
