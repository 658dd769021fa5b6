//! How well two opinions agree: precision, recall and F1 of every class, Cohen's kappa (Cohen
//! 1960), the confusion matrix.

use serde::Serialize;

/// How well what was found agrees with what is held to be true.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Agreement {
    /// Episodes that both have an opinion on.
    pub episodes: usize,
    /// Share on which they agree.
    pub accuracy: f64,
    /// Agreement beyond chance: 1 is perfect, 0 is chance. None where chance
    /// alone would agree always.
    pub kappa: Option<f64>,
    /// Mean F1 of the classes that occur in the truth.
    pub macro_f1: f64,
    /// By class, in the order of the names given, then as they occur.
    pub classes: Vec<ClassAgreement>,
    /// How often a class of the truth (row) was found as another (column), in
    /// the order of `classes`.
    pub confusion: Vec<Vec<usize>>,
}

/// Agreement on one class: its counts, precision, recall and F1.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct ClassAgreement {
    /// Name of the class that is counted.
    pub class: String,
    /// How often it is true.
    pub support: usize,
    /// How often it was found.
    pub found: usize,
    /// Share of what was found that is true; none where nothing was found.
    pub precision: Option<f64>,
    /// Share of what is true that was found; none where nothing is true.
    pub recall: Option<f64>,
    /// Their harmonic mean; 0 where nothing was found rightly.
    pub f1: f64,
}

/// Compares pairs of (truth, found). `order` names classes that shall stand first.
pub fn agreement<'a>(
    pairs: impl IntoIterator<Item = (&'a str, &'a str)>,
    order: &[&str],
) -> Agreement {
    let pairs: Vec<(&str, &str)> = pairs.into_iter().collect();
    let mut names: Vec<&str> = pairs
        .iter()
        .flat_map(|(truth, found)| [*truth, *found])
        .collect();
    names.sort_unstable_by_key(|name| {
        (
            order
                .iter()
                .position(|known| known == name)
                .unwrap_or(usize::MAX),
            *name,
        )
    });
    names.dedup();
    let index = |name: &str| {
        names
            .iter()
            .position(|known| *known == name)
            .expect("every name was listed")
    };
    let mut confusion = vec![vec![0; names.len()]; names.len()];
    for (truth, found) in &pairs {
        confusion[index(truth)][index(found)] += 1;
    }
    let total = pairs.len() as f64;
    let support = |class: usize| confusion[class].iter().sum::<usize>();
    let found = |class: usize| confusion.iter().map(|row| row[class]).sum::<usize>();
    let share = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
    let classes: Vec<ClassAgreement> = (0..names.len())
        .map(|class| {
            let (right, support, found) = (confusion[class][class], support(class), found(class));
            ClassAgreement {
                class: names[class].to_owned(),
                support,
                found,
                precision: share(right, found),
                recall: share(right, support),
                f1: share(2 * right, support + found).unwrap_or(0.0),
            }
        })
        .collect();
    let agreed: usize = (0..names.len()).map(|class| confusion[class][class]).sum();
    let accuracy = if pairs.is_empty() {
        0.0
    } else {
        agreed as f64 / total
    };
    let by_chance: f64 = (0..names.len())
        .map(|class| support(class) as f64 / total * (found(class) as f64 / total))
        .sum();
    let true_ones: Vec<f64> = classes
        .iter()
        .filter(|class| class.support > 0)
        .map(|class| class.f1)
        .collect();
    Agreement {
        episodes: pairs.len(),
        accuracy,
        kappa: (!pairs.is_empty() && by_chance < 1.0)
            .then(|| (accuracy - by_chance) / (1.0 - by_chance)),
        // an empty sum is -0
        macro_f1: (0.0 + true_ones.iter().sum::<f64>()) / true_ones.len().max(1) as f64,
        classes,
        confusion,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The worked example of Cohen's kappa that textbooks use: 20, 5, 10, 15 of 50, kappa 0.4.
    #[test]
    fn kappa_is_that_of_the_textbook() {
        let cells = [
            ("yes", "yes", 20),
            ("yes", "no", 5),
            ("no", "yes", 10),
            ("no", "no", 15),
        ];
        let pairs = cells
            .iter()
            .flat_map(|(truth, found, count)| std::iter::repeat_n((*truth, *found), *count));
        let found = agreement(pairs, &["yes", "no"]);
        assert!((found.kappa.unwrap() - 0.4).abs() < 1e-12);
        assert!((found.accuracy - 0.7).abs() < 1e-12);
        assert_eq!(found.confusion, [[20, 5], [10, 15]]);
        let yes = &found.classes[0];
        assert_eq!(
            (yes.precision, yes.recall),
            (Some(20.0 / 30.0), Some(20.0 / 25.0))
        );
        let (yes, no) = (40.0 / 55.0, 30.0 / 45.0);
        assert!((found.macro_f1 - (yes + no) / 2.0).abs() < 1e-12);
    }

    #[test]
    fn nothing_and_chance_are_no_agreement() {
        assert_eq!(agreement([], &[]).kappa, None);
        assert_eq!(agreement([("a", "a"), ("a", "a")], &[]).kappa, None);
        let never_found = agreement([("a", "b"), ("b", "b")], &[]);
        assert_eq!(
            (never_found.classes[0].precision, never_found.classes[0].f1),
            (None, 0.0)
        );
        // a class that is never true counts in no mean
        assert_eq!(agreement([("a", "a"), ("a", "c")], &[]).macro_f1, 2.0 / 3.0);
    }
}
