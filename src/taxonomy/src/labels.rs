//! What people, judges and injected faults say about episodes: in from CSV and JSON and out again,
//! and one label an episode out of several. Stores nothing.

use std::collections::{BTreeMap, BTreeSet};

use reel_tables::LabelRow;
use serde::Deserialize;
use serde_json::Value;

use crate::{CLASSES, TaxonomyError};

/// One label an episode.
pub type LabelSet = BTreeMap<String, LabelRow>;

/// The columns of a label in CSV.
const COLUMNS: [&str; 10] = reel_world::words! {
    episode_id author kind class sub_class step confidence note at_ms blind
};

/// What a line that leaves it out says.
#[derive(Clone, Copy, Debug)]
pub struct Defaults<'a> {
    /// Author of the labels whose line names none.
    pub author: &'a str,
    /// When it was said, milliseconds since 1970.
    pub at_ms: i64,
    /// Classes of a taxonomy of one's own, which a label may have beside those of the paper.
    pub own_classes: &'a BTreeSet<String>,
}

/// A label as files have it: what is left out is filled in.
#[derive(Deserialize)]
struct LabelLine {
    episode_id: String,
    class: String,
    author: Option<String>,
    kind: Option<String>,
    sub_class: Option<String>,
    step: Option<i32>,
    confidence: Option<f64>,
    note: Option<String>,
    at_ms: Option<i64>,
    blind: Option<bool>,
}

/// Reads CSV with a header line; needed are `episode_id` and `class`. `place` is what
/// messages call the text.
///
/// # Errors
/// The first line that is no label.
pub fn from_csv(
    text: &str,
    place: &str,
    defaults: Defaults<'_>,
) -> Result<Vec<LabelRow>, TaxonomyError> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let wrong = |reason: String| TaxonomyError::Label {
        place: place.to_owned(),
        reason,
    };
    let header = reader
        .headers()
        .map_err(|error| wrong(error.to_string()))?
        .clone();
    if let Some(unknown) = header.iter().find(|column| !COLUMNS.contains(column)) {
        return Err(wrong(format!(
            "the column '{unknown}' is unknown; there are {}",
            COLUMNS.join(", ")
        )));
    }
    let mut labels = Vec::new();
    for (line, row) in (2..).zip(reader.deserialize::<LabelLine>()) {
        let place = format!("{place}, line {line}");
        let row = row.map_err(|error| TaxonomyError::Label {
            place: place.clone(),
            reason: error.to_string(),
        })?;
        labels.push(row.checked(&place, defaults)?);
    }
    Ok(labels)
}

/// Reads a JSON list of labels, or one JSON object a line.
///
/// # Errors
/// The first that is no label.
pub fn from_json(
    text: &str,
    place: &str,
    defaults: Defaults<'_>,
) -> Result<Vec<LabelRow>, TaxonomyError> {
    let wrong = |place: &str, error: serde_json::Error| TaxonomyError::Label {
        place: place.into(),
        reason: error.to_string(),
    };
    if text.trim_start().starts_with('[') {
        let rows: Vec<LabelLine> =
            serde_json::from_str(text).map_err(|error| wrong(place, error))?;
        return (1..)
            .zip(rows)
            .map(|(number, row)| row.checked(&format!("{place}, label {number}"), defaults))
            .collect();
    }
    let lines = (1..)
        .zip(text.lines())
        .filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(number, line)| {
            let place = format!("{place}, line {number}");
            serde_json::from_str::<LabelLine>(line)
                .map_err(|error| wrong(&place, error))?
                .checked(&place, defaults)
        })
        .collect()
}

/// The label that a fault left beside its trace (`<trace>.label.json`); none where it did
/// not cost the success.
///
/// # Errors
/// When the file is no such label.
pub fn injected(text: &str, place: &str, at_ms: i64) -> Result<Option<LabelRow>, TaxonomyError> {
    let wrong = |reason: String| TaxonomyError::Label {
        place: place.to_owned(),
        reason,
    };
    let file: Value = serde_json::from_str(text).map_err(|error| wrong(error.to_string()))?;
    let primary = &file["primary"];
    if primary.is_null() && file.get("primary").is_some() {
        return Ok(None);
    }
    let said = |value: &Value, name: &str| {
        value[name].as_str().map(str::to_owned).ok_or_else(|| {
            wrong(format!(
                "it has no text `{name}`: no label of an injected fault"
            ))
        })
    };
    let label = LabelLine {
        episode_id: said(&file, "episode_id")?,
        class: said(primary, "class")?,
        author: None,
        kind: Some("injected".into()),
        sub_class: Some(said(primary, "sub_class")?),
        step: primary["step"]
            .as_i64()
            .and_then(|step| i32::try_from(step).ok()),
        confidence: None,
        note: None,
        at_ms: None,
        blind: None,
    };
    label
        .checked(
            place,
            Defaults {
                author: "injected",
                at_ms,
                own_classes: &BTreeSet::new(),
            },
        )
        .map(Some)
}

impl LabelLine {
    fn checked(self, place: &str, defaults: Defaults<'_>) -> Result<LabelRow, TaxonomyError> {
        let wrong = |reason: String| TaxonomyError::Label {
            place: place.to_owned(),
            reason,
        };
        let known = defaults.own_classes;
        if !CLASSES.contains(&self.class.as_str()) && !known.contains(&self.class) {
            let known = known.iter().map(String::as_str);
            let known: Vec<&str> = CLASSES.into_iter().chain(known).collect();
            return Err(wrong(format!(
                "the class '{}' is none of {}",
                self.class,
                known.join(", ")
            )));
        }
        if self
            .confidence
            .is_some_and(|confidence| !(0.0..=1.0).contains(&confidence))
        {
            return Err(wrong("the confidence has to lie between 0 and 1".into()));
        }
        if self.episode_id.is_empty() {
            return Err(wrong("it names no episode".into()));
        }
        let said = |text: Option<String>| text.filter(|text| !text.is_empty());
        Ok(LabelRow {
            episode_id: self.episode_id,
            author: said(self.author).unwrap_or_else(|| defaults.author.to_owned()),
            kind: said(self.kind).unwrap_or_else(|| "human".to_owned()),
            class: self.class,
            sub_class: said(self.sub_class),
            step: self.step,
            confidence: self.confidence,
            note: said(self.note),
            at_ms: self.at_ms.unwrap_or(defaults.at_ms),
            blind: self.blind,
        })
    }
}

/// Labels as CSV, which [`from_csv`] reads.
pub fn to_csv(labels: &[LabelRow]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut write = || -> Result<(), csv::Error> {
        if labels.is_empty() {
            writer.write_record(COLUMNS)?;
        }
        labels.iter().try_for_each(|label| writer.serialize(label))
    };
    write().expect("memory takes it");
    String::from_utf8(writer.into_inner().expect("memory takes it")).expect("texts are UTF-8")
}

/// Labels as one JSON object a line, which [`from_json`] reads.
pub fn to_json(labels: &[LabelRow]) -> String {
    labels
        .iter()
        .map(|label| serde_json::to_string(label).expect("a label is JSON") + "\n")
        .collect()
}

/// One label an episode: of an author, of a kind, or `agreed`: what was adjudicated, else what all
/// people say who labelled it. Of several by the same author the latest counts; of several authors
/// of a kind, the one that was adjudicated or said last.
pub fn label_set(labels: &[LabelRow], name: &str) -> LabelSet {
    let mut sorted: Vec<&LabelRow> = labels.iter().collect();
    sorted.sort_by(|one, other| (one.at_ms, &one.author).cmp(&(other.at_ms, &other.author)));
    if name != "agreed" {
        let of_set = sorted
            .into_iter()
            .filter(|label| label.author == name || label.kind == name);
        return of_set
            .map(|label| (label.episode_id.clone(), label.clone()))
            .collect();
    }
    let mut agreed = LabelSet::new();
    for (episode, labels) in by_episode(&sorted) {
        let adjudicated = labels
            .iter()
            .rev()
            .find(|label| label.kind == "adjudicated");
        let classes: BTreeSet<&str> = labels.iter().map(|label| label.class.as_str()).collect();
        if let Some(label) = adjudicated.or_else(|| labels.last().filter(|_| classes.len() == 1)) {
            agreed.insert(episode.to_owned(), (*label).clone());
        }
    }
    agreed
}

/// Episodes on whose class people disagree and nobody has decided, with what each said last.
pub fn disputed(labels: &[LabelRow]) -> BTreeMap<String, Vec<LabelRow>> {
    let mut sorted: Vec<&LabelRow> = labels.iter().collect();
    sorted.sort_by_key(|label| label.at_ms);
    let open = by_episode(&sorted).into_iter().filter(|(_, labels)| {
        let classes: BTreeSet<&str> = labels.iter().map(|label| label.class.as_str()).collect();
        classes.len() > 1 && labels.iter().all(|label| label.kind != "adjudicated")
    });
    open.map(|(episode, labels)| (episode.to_owned(), labels.into_iter().cloned().collect()))
        .collect()
}

/// What people said, the last word of each, by episode.
fn by_episode<'a>(sorted: &[&'a LabelRow]) -> BTreeMap<&'a str, Vec<&'a LabelRow>> {
    let mut last: BTreeMap<(&str, &str, &str), &LabelRow> = BTreeMap::new();
    for label in sorted
        .iter()
        .filter(|label| label.kind == "human" || label.kind == "adjudicated")
    {
        last.insert((&label.episode_id, &label.author, &label.kind), label);
    }
    let mut episodes: BTreeMap<&str, Vec<&LabelRow>> = BTreeMap::new();
    for ((episode, ..), label) in last {
        episodes.entry(episode).or_default().push(label);
    }
    for labels in episodes.values_mut() {
        labels.sort_by_key(|label| label.at_ms);
    }
    episodes
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEFAULTS: Defaults<'_> = Defaults {
        author: "ann",
        at_ms: 5,
        own_classes: &BTreeSet::new(),
    };

    fn label(episode: &str, author: &str, kind: &str, class: &str, at_ms: i64) -> LabelRow {
        let (sub_class, step, confidence, note) = (None, None, None, None);
        LabelRow {
            episode_id: episode.into(),
            author: author.into(),
            kind: kind.into(),
            class: class.into(),
            sub_class,
            step,
            confidence,
            note,
            at_ms,
            blind: None,
        }
    }

    #[test]
    fn labels_survive_csv_and_json() {
        let mut labels = vec![
            label("a", "ann", "human", "Other", 5),
            label("b", "bob", "human", "Lost Memory", 6),
        ];
        labels[0].note = Some("commas, \"quotes\"\nand lines".into());
        labels[1].step = Some(3);
        labels[1].confidence = Some(0.5);
        labels[1].sub_class = Some("oscillation".into());
        assert_eq!(from_csv(&to_csv(&labels), "x", DEFAULTS).unwrap(), labels);
        assert_eq!(from_json(&to_json(&labels), "x", DEFAULTS).unwrap(), labels);
        assert_eq!(from_csv(&to_csv(&[]), "x", DEFAULTS).unwrap(), []);
        let short = from_csv("episode_id,class\na,Other\n", "x", DEFAULTS).unwrap();
        assert_eq!(short, [label("a", "ann", "human", "Other", 5)]);
        let list = from_json(
            "[{\"episode_id\": \"a\", \"class\": \"Other\"}]",
            "x",
            DEFAULTS,
        )
        .unwrap();
        assert_eq!(list, short);
    }

    #[test]
    fn what_is_no_label_is_named_with_its_line() {
        for (text, place, complaint) in [
            (
                "episode_id,class\na,Other\nb,Bad Luck\n",
                "labels.csv, line 3",
                "none of Object Confusion",
            ),
            ("episode_id,klass\n", "labels.csv", "'klass' is unknown"),
            ("episode_id\na\n", "labels.csv, line 2", "class"),
            (
                "episode_id,class,confidence\na,Other,7\n",
                "labels.csv, line 2",
                "between 0 and 1",
            ),
            (
                "episode_id,class,step\na,Other,x\n",
                "labels.csv, line 2",
                "invalid digit",
            ),
            (
                "episode_id,class\n,Other\n",
                "labels.csv, line 2",
                "names no episode",
            ),
        ] {
            let refused = from_csv(text, "labels.csv", DEFAULTS)
                .unwrap_err()
                .to_string();
            assert!(
                refused.starts_with(place) && refused.contains(complaint),
                "{refused}"
            );
        }
        let refused = from_json(
            "{\"episode_id\": \"a\", \"class\": \"Other\"}\n{",
            "l",
            DEFAULTS,
        )
        .unwrap_err()
        .to_string();
        assert!(refused.starts_with("l, line 2"), "{refused}");
    }

    #[test]
    fn people_agree_or_somebody_decides() {
        let labels = [
            label("one", "ann", "human", "Other", 1),
            label("one", "bob", "human", "Other", 2),
            label("two", "ann", "human", "Other", 1),
            label("two", "bob", "human", "Lost Memory", 2),
            label("three", "ann", "human", "Other", 1),
            label("three", "bob", "human", "Lost Memory", 2),
            label("three", "cem", "adjudicated", "Object Confusion", 3),
            // changed her mind
            label("four", "ann", "human", "Other", 1),
            label("four", "bob", "human", "Lost Memory", 2),
            label("four", "ann", "human", "Lost Memory", 4),
            label("one", "model", "judge", "Lost Memory", 9),
        ];
        let agreed = label_set(&labels, "agreed");
        let classes: Vec<_> = agreed
            .iter()
            .map(|(episode, label)| (episode.as_str(), label.class.as_str()))
            .collect();
        assert_eq!(
            classes,
            [
                ("four", "Lost Memory"),
                ("one", "Other"),
                ("three", "Object Confusion")
            ]
        );
        assert_eq!(disputed(&labels).keys().collect::<Vec<_>>(), ["two"]);
        assert_eq!(label_set(&labels, "judge")["one"].class, "Lost Memory");
        assert_eq!(label_set(&labels, "ann")["four"].class, "Lost Memory");
    }

    #[test]
    fn an_injected_fault_is_a_label() {
        let file = r#"{"episode_id": "e", "primary": {"class": "Other", "sub_class": "timeout", "step": 3}}"#;
        let found = injected(file, "x", 1).unwrap().unwrap();
        assert_eq!(
            (
                found.author.as_str(),
                found.sub_class.as_deref(),
                found.step
            ),
            ("injected", Some("timeout"), Some(3))
        );
        assert_eq!(
            injected(r#"{"episode_id": "e", "primary": null}"#, "x", 1).unwrap(),
            None
        );
        assert!(injected("{}", "x", 1).is_err());
    }
}
