//! What a set of tasks is like, in numbers that can be laid beside another set's. Judges nothing.

use reel_world::{Family, Task};
use serde::Serialize;

/// How a quantity is distributed.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Distribution {
    /// How many values there are.
    pub count: usize,
    /// The smallest of all values.
    pub min: f64,
    /// A tenth lies below.
    pub p10: f64,
    /// The median: the middle one of the sorted values, the upper of two.
    pub median: f64,
    /// Arithmetic mean of all values.
    pub mean: f64,
    /// A tenth lies above.
    pub p90: f64,
    /// The largest of all values.
    pub max: f64,
}

impl Distribution {
    /// Of some values; none of none.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let at = |share: f64| values[(last as f64 * share).round() as usize];
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Some(Self {
            count: values.len(),
            min: values[0],
            p10: at(0.1),
            median: at(0.5),
            mean,
            p90: at(0.9),
            max: values[last],
        })
    }
}

/// One quantity of the tasks of a family.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct DistributionRow {
    /// The family; none: of all.
    pub family: Option<Family>,
    /// Name of the quantity with its unit, e.g. `plan length (steps)`.
    pub quantity: &'static str,
    /// How it is distributed.
    pub distribution: Distribution,
}

/// The values of a quantity in a task.
type Values = fn(&Task) -> Vec<f64>;

/// What is counted in a task, by name.
const QUANTITIES: [(&str, Values); 8] = [
    ("plan length (steps)", |task| vec![task.plan.len() as f64]),
    ("instruction length (words)", |task| {
        vec![task.instruction.split_whitespace().count() as f64]
    }),
    ("objects placed", |task| vec![task.objects.len() as f64]),
    ("object distractors", |task| {
        vec![task.object_distractors.len() as f64]
    }),
    ("source distractors", |task| {
        vec![task.src_distractors.len() as f64]
    }),
    ("destination distractors", |task| {
        vec![task.dest_distractors.len() as f64]
    }),
    ("object size, longest side (m)", |task| {
        sizes(task, |size| size.iter().copied().fold(0.0, f64::max))
    }),
    ("object height (m)", |task| sizes(task, |size| size[2])),
];

/// The distributions over some tasks, of all and by family.
pub fn report(tasks: &[Task]) -> Vec<DistributionRow> {
    let families = [None].into_iter().chain(Family::ALL.map(Some));
    let rows = families.flat_map(|family| {
        let of_family = tasks
            .iter()
            .filter(move |task| family.is_none_or(|family| task.family == family));
        QUANTITIES.iter().filter_map(move |(quantity, of)| {
            let distribution = Distribution::of(of_family.clone().flat_map(of).collect())?;
            Some(DistributionRow {
                family,
                quantity,
                distribution,
            })
        })
    });
    rows.collect()
}

fn sizes(task: &Task, of: impl Fn([f64; 3]) -> f64) -> Vec<f64> {
    task.objects.iter().map(|object| of(object.size)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distribution_is_of_its_values() {
        let of = Distribution::of((0..=10).rev().map(f64::from).collect()).unwrap();
        assert_eq!(
            (of.count, of.min, of.p10, of.median, of.mean, of.p90, of.max),
            (11, 0.0, 1.0, 5.0, 5.0, 9.0, 10.0)
        );
        assert_eq!(Distribution::of(Vec::new()), None);
    }
}
