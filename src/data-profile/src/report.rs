//! Reports as tables for people.

use std::fmt;

use crate::{
    Balance, ColumnDrift, ColumnProfile, ConversationProfile, Diff, Duplicates, JoinReport,
    Numbers, Profile, RowChanges, SchemaChange, TopValue,
};

/// Characters of a type or a name in a table.
const CELL: usize = 44;

/// A number as short as it stays exact to 4 digits.
fn short(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".to_owned()
    } else if value.fract() == 0.0 && size < 1e9 {
        format!("{value:.0}")
    } else if (0.001..1e6).contains(&size) {
        let digits = (3 - size.log10().floor() as i32).clamp(0, 6);
        format!("{value:.*}", usize::try_from(digits).unwrap_or_default())
    } else {
        format!("{value:.3e}")
    }
}

fn bytes(count: u64) -> String {
    let mut size = count as f64;
    for unit in ["bytes", "KiB", "MiB"] {
        if size < 1024.0 {
            return format!("{} {unit}", short((size * 10.0).round() / 10.0));
        }
        size /= 1024.0;
    }
    format!("{size:.2} GiB")
}

fn plural(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

fn percent(share: f64) -> String {
    format!("{:.1}%", 100.0 * share)
}

/// A text cut to the width of a cell.
fn cell(text: &str) -> String {
    match text.char_indices().nth(CELL - 1) {
        Some((end, _)) if text.chars().count() > CELL => format!("{}…", &text[..end]),
        _ => text.to_owned(),
    }
}

impl Numbers {
    fn at(&self, share: f64) -> String {
        self.quantiles
            .iter()
            .find(|(known, _)| (known - share).abs() < 1e-9)
            .map_or_else(|| "-".to_owned(), |(_, value)| short(*value))
    }

    fn row(&self) -> String {
        format!(
            "{:>10} {:>10} {:>10} {:>10} {:>10} {:>10}",
            short(self.min),
            self.at(0.05),
            self.at(0.5),
            self.at(0.95),
            short(self.max),
            short(self.mean),
        )
    }
}

/// The heads of [`Numbers::row`].
const NUMBER_HEADS: &str = "       min         5%     median        95%        max       mean";

impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let files = plural(self.files.len() as u64, "file", "files");
        let rows = plural(self.rows, "row", "rows");
        writeln!(f, "{rows}, {files}, {}", bytes(self.bytes))?;
        writeln!(f, "rows that repeat an earlier one: {}", self.duplicates)?;
        if let Some(keys) = &self.key_duplicates {
            let names = keys.columns.join(", ");
            writeln!(f, "rows that repeat the key {names}: {keys}")?;
        }
        self.table(f)?;
        self.numbers(f)?;
        self.lengths(f)?;
        if let Some(conversation) = &self.conversation {
            write!(f, "{conversation}")?;
        }
        for (column, classes) in &self.balance {
            writeln!(f, "\nbalance by {column}")?;
            for class in classes {
                let share = percent(class.share);
                writeln!(
                    f,
                    "  {:CELL$} {:>10} {share:>7}",
                    cell(&class.class),
                    class.count
                )?;
            }
        }
        notes(f, &self.notes)
    }
}

impl Profile {
    fn table(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let heads = ["column", "type"];
        writeln!(
            f,
            "\n{:CELL$} {:CELL$}   null   distinct  most frequent",
            heads[0], heads[1]
        )?;
        for column in &self.columns {
            let distinct = match (column.distinct, column.distinct_exact) {
                (Some(count), true) => count.to_string(),
                (Some(count), false) => format!("~{count}"),
                (None, _) => "-".to_owned(),
            };
            let (name, kind) = (cell(&column.name), cell(&column.type_name));
            let line = format!(
                "{name:CELL$} {kind:CELL$} {:>6} {distinct:>10}  {}",
                percent(column.null_share),
                column.most_frequent(),
            );
            writeln!(f, "{}", line.trim_end())?;
        }
        Ok(())
    }

    fn numbers(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let numbers = self
            .columns
            .iter()
            .filter_map(|column| Some((column, column.numbers.as_ref()?)));
        for (index, (column, numbers)) in numbers.enumerate() {
            if index == 0 {
                writeln!(f, "\n{:CELL$} {NUMBER_HEADS}", "numbers")?;
            }
            writeln!(f, "{:CELL$} {}", cell(&column.name), numbers.row())?;
        }
        let times = self
            .columns
            .iter()
            .filter_map(|column| Some((column, column.range.as_ref()?)));
        for (index, (column, (first, last))) in times.enumerate() {
            if index == 0 {
                writeln!(f, "\n{:CELL$} from, to", "times")?;
            }
            writeln!(f, "{:CELL$} {first}, {last}", cell(&column.name))?;
        }
        Ok(())
    }

    fn lengths(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let lengths = self
            .columns
            .iter()
            .filter_map(|column| Some((column, column.lengths.as_ref()?)));
        for (index, (column, lengths)) in lengths.enumerate() {
            if index == 0 {
                writeln!(f, "\n{:CELL$} {NUMBER_HEADS}", "lengths")?;
            }
            let name = format!("{} ({})", column.name, column.length_unit);
            writeln!(f, "{:CELL$} {}", cell(&name), lengths.row())?;
        }
        Ok(())
    }
}

impl ColumnProfile {
    fn most_frequent(&self) -> String {
        // Values that occur once say nothing of frequency.
        let told = self.top.iter().filter(|top| top.count > 1);
        let at_least = if self.top_exact { "" } else { ">=" };
        let told: Vec<String> = told
            .map(|TopValue { value, count }| format!("{} {at_least}{count}", cell(value)))
            .collect();
        told.join(" | ")
    }
}

impl fmt::Display for Duplicates {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.repeated)?;
        if let Some((row, count)) = self.largest.first() {
            write!(f, ", the most frequent {count} times (first in row {row})")?;
        }
        if self.without_key > 0 && !self.columns.is_empty() {
            write!(
                f,
                "; {} without a key",
                plural(self.without_key, "row", "rows")
            )?;
        }
        Ok(())
    }
}

impl fmt::Display for ConversationProfile {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let head = format!("conversations in {}", self.columns);
        writeln!(f, "\n{:CELL$} {NUMBER_HEADS}", cell(&head))?;
        let lines = [
            ("turns of an example", &self.turns),
            ("answers of an example", &self.answers),
            ("characters of an answer", &self.answer_characters),
            ("images of an example", &self.images),
        ];
        for (name, numbers) in lines {
            if let Some(numbers) = numbers {
                writeln!(f, "{name:CELL$} {}", numbers.row())?;
            }
        }
        Ok(())
    }
}

fn notes(f: &mut fmt::Formatter, notes: &[String]) -> fmt::Result {
    notes
        .iter()
        .try_for_each(|note| writeln!(f, "note: {note}"))
}

impl fmt::Display for Diff {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [old, new] = self.rows;
        let RowChanges {
            added,
            removed,
            unchanged,
        } = self.whole_rows;
        writeln!(f, "{old} rows before, {new} rows after")?;
        writeln!(
            f,
            "whole rows: {unchanged} unchanged, {removed} removed, {added} added"
        )?;
        if let Some(keys) = &self.by_key {
            writeln!(
                f,
                "keys: {} unchanged, {} changed, {} removed, {} added",
                keys.unchanged, keys.changed, keys.removed, keys.added
            )?;
            if keys.duplicated != [0, 0] {
                let [old, new] = keys.duplicated;
                writeln!(f, "keys of several rows: {old} before, {new} after")?;
            }
            if keys.without_key != [0, 0] {
                let [old, new] = keys.without_key;
                writeln!(f, "rows without a key: {old} before, {new} after")?;
            }
        }
        if self.schema.is_empty() {
            writeln!(f, "columns: the same")?;
        }
        for change in &self.schema {
            writeln!(f, "{change}")?;
        }
        let drifted = self.columns.iter().filter(|column| column.drifted).count();
        let of = self.columns.len();
        writeln!(
            f,
            "\n{drifted} of {of} columns drifted (PSI >= {})",
            self.threshold
        )?;
        writeln!(
            f,
            "{:CELL$} {:10} {:>8} {:>7} {:>15} {:>21}",
            "column", "compared", "PSI", "JS", "null", "mean"
        )?;
        self.columns.iter().try_for_each(|it| writeln!(f, "{it}"))?;
        self.balance.iter().try_for_each(|it| write!(f, "{it}"))?;
        notes(f, &self.notes)
    }
}

impl fmt::Display for SchemaChange {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let name = &self.column;
        match (&self.old, &self.new) {
            (Some(old), Some(new)) => write!(f, "column {name}: {old} -> {new}"),
            (Some(old), None) => write!(f, "column {name} removed: {old}"),
            (None, new) => write!(f, "column {name} added: {}", new.as_deref().unwrap_or("")),
        }
    }
}

impl fmt::Display for ColumnDrift {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let nulls = self.null_share.map(percent).join(" -> ");
        let means = self
            .mean
            .map_or_else(|| "-".to_owned(), |means| means.map(short).join(" -> "));
        write!(
            f,
            "{:CELL$} {:10} {:>8.4} {:>7.4} {nulls:>15} {means:>21}{}",
            cell(&self.column),
            self.compared,
            self.psi,
            self.js,
            if self.drifted { "  drifted" } else { "" }
        )
    }
}

impl fmt::Display for Balance {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "\nbalance by {}", self.column)?;
        let mut classes: Vec<&str> = Vec::new();
        for class in self.old.iter().chain(&self.new) {
            if !classes.contains(&class.class.as_str()) {
                classes.push(&class.class);
            }
        }
        for class in classes {
            let share = [&self.old, &self.new].map(|side| {
                let found = side.iter().find(|it| it.class == class);
                percent(found.map_or(0.0, |it| it.share))
            });
            writeln!(f, "  {:CELL$} {:>18}", cell(class), share.join(" -> "))?;
        }
        Ok(())
    }
}

impl fmt::Display for JoinReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let rows = plural(self.written, "row", "rows");
        writeln!(f, "{rows} in {}", self.out.display())?;
        for (side, name) in ["left", "right"].into_iter().enumerate() {
            writeln!(
                f,
                "{name:6} {} rows, {} unmatched, {} keys of several rows, {} rows without a key",
                self.rows[side],
                self.unmatched[side],
                self.duplicate_keys[side],
                self.without_key[side],
            )?;
        }
        if self.multiplies() {
            writeln!(
                f,
                "the join multiplies rows: {} of the left set became {}; {} keys have several rows on both sides",
                self.rows[0], self.written, self.many_to_many
            )?;
        }
        for (from, to) in &self.renamed {
            writeln!(f, "column {from} of the right set is {to}")?;
        }
        notes(f, &self.notes)
    }
}
