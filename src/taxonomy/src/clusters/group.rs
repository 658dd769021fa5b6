//! Groups sequences around medoids by a threshold on their distance. Never draws at random: equal
//! sequences give equal groups, whatever their order.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::{CallKind, CallSequence, distance::EditDistance};

/// Different sequences whose distances are all computed; of more a sample decides the medoids.
pub const SAMPLE_MAX: usize = 10_000;

/// The sequences of episodes, grouped around medoids.
#[derive(Clone, PartialEq, Debug)]
pub struct Grouping {
    /// Indices of the members with their distance to the medoid, which comes first; the largest
    /// group first.
    pub groups: Vec<Vec<(usize, f64)>>,
    /// Number of different sequences.
    pub sequences: usize,
    /// How many of them decided the medoids, where not all did.
    pub sampled: Option<usize>,
}

/// A sequence and everything that has it.
struct Different {
    symbols: Vec<u16>,
    members: Vec<usize>,
}

/// Groups sequences: the one with most others within `threshold` becomes a medoid and takes these
/// with it, until none is left; then each goes to its nearest medoid, and each group's medoid
/// becomes the member with the least total distance.
pub fn group(sequences: &[CallSequence], threshold: f64) -> Grouping {
    let all = different(sequences);
    // Every so manieth in the order of the sequences: as evenly spread as they are.
    let stride = all.len().div_ceil(SAMPLE_MAX).max(1);
    let sample: Vec<usize> = (0..all.len()).step_by(stride).collect();
    let near = neighbours(&all, &sample, threshold);
    let mut open = vec![true; sample.len()];
    let weight = |index: usize| all[sample[index]].members.len();
    let mut medoids: Vec<usize> = Vec::new();
    let mut counts: Vec<usize> = near
        .iter()
        .map(|near| near.iter().map(|other| weight(*other as usize)).sum())
        .collect();
    loop {
        let best = (0..sample.len())
            .filter(|index| open[*index])
            .max_by_key(|index| (counts[*index], std::cmp::Reverse(*index)));
        let Some(best) = best else { break };
        medoids.push(sample[best]);
        for taken in &near[best] {
            let taken = *taken as usize;
            if std::mem::replace(&mut open[taken], false) {
                near[taken]
                    .iter()
                    .for_each(|other| counts[*other as usize] -= weight(taken));
            }
        }
    }
    let mut groups = assign(&all, &medoids, threshold);
    for members in &mut groups {
        recentre(&all, members);
    }
    let mut found: Vec<Vec<(usize, f64)>> = groups
        .iter()
        .filter(|members| !members.is_empty())
        .map(|members| {
            let medoid = Relative::from(&all[members[0]]);
            let mut indices: Vec<(usize, f64)> = Vec::new();
            for member in members {
                let distance = medoid.to(&all[*member]);
                indices.extend(all[*member].members.iter().map(|index| (*index, distance)));
            }
            indices
        })
        .collect();
    found.sort_by_key(|members| (std::cmp::Reverse(members.len()), members[0].0));
    Grouping {
        groups: found,
        sequences: all.len(),
        sampled: (stride > 1).then_some(sample.len()),
    }
}

/// Different sequences in their order, with the episodes that have each.
fn different(sequences: &[CallSequence]) -> Vec<Different> {
    let mut kinds: BTreeMap<&CallKind, u16> = BTreeMap::new();
    for kind in sequences.iter().flat_map(|one| &one.calls) {
        let next = kinds.len() as u16;
        kinds.entry(kind).or_insert(next);
    }
    let mut by_symbols: BTreeMap<Vec<u16>, Vec<usize>> = BTreeMap::new();
    for (index, sequence) in sequences.iter().enumerate() {
        let symbols = sequence.calls.iter().map(|kind| kinds[kind]).collect();
        by_symbols.entry(symbols).or_default().push(index);
    }
    by_symbols
        .into_iter()
        .map(|(symbols, members)| Different { symbols, members })
        .collect()
}

/// A sequence that others are compared with, by their distance as a share of the longer one.
struct Relative<'s> {
    distance: EditDistance<'s>,
    length: usize,
}

impl<'s> Relative<'s> {
    fn from(one: &'s Different) -> Self {
        Self {
            distance: EditDistance::from(&one.symbols),
            length: one.symbols.len(),
        }
    }

    fn to(&self, other: &Different) -> f64 {
        f64::from(self.distance.to(&other.symbols)) / self.longest(other)
    }

    /// The same, where it is at most `threshold`. The difference of the lengths is a lower bound.
    fn within(&self, other: &Different, threshold: f64) -> Option<f64> {
        let shortest = self.length.abs_diff(other.symbols.len()) as f64;
        if shortest > threshold * self.longest(other) {
            return None;
        }
        Some(self.to(other)).filter(|distance| *distance <= threshold)
    }

    fn longest(&self, other: &Different) -> f64 {
        self.length.max(other.symbols.len()).max(1) as f64
    }
}

/// For each of the sample which others, itself included, are within the threshold.
fn neighbours(all: &[Different], sample: &[usize], threshold: f64) -> Vec<Vec<u32>> {
    let later = |index: usize| {
        let from = Relative::from(&all[sample[index]]);
        (index as u32..sample.len() as u32)
            .filter(|other| {
                let other = &all[sample[*other as usize]];
                from.within(other, threshold).is_some()
            })
            .collect()
    };
    let later: Vec<Vec<u32>> = (0..sample.len()).into_par_iter().map(later).collect();
    // The distance is the same both ways.
    let mut near = vec![Vec::new(); sample.len()];
    for (index, others) in later.iter().enumerate() {
        for other in others {
            near[index].push(*other);
            if *other as usize != index {
                near[*other as usize].push(index as u32);
            }
        }
    }
    near
}

/// Each sequence beside its nearest medoid; one that is near none of them is alone.
fn assign(all: &[Different], medoids: &[usize], threshold: f64) -> Vec<Vec<usize>> {
    let nearest = |one: &Different| {
        let from = Relative::from(one);
        let best = medoids
            .iter()
            .enumerate()
            .filter_map(|(position, medoid)| {
                Some((from.within(&all[*medoid], threshold)?, position))
            })
            .min_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)))?;
        Some(best.1)
    };
    let found: Vec<Option<usize>> = all.par_iter().map(nearest).collect();
    let mut groups = vec![Vec::new(); medoids.len()];
    for (index, position) in found.into_iter().enumerate() {
        match position {
            Some(position) => groups[position].push(index),
            None => groups.push(vec![index]),
        }
    }
    groups
}

/// Puts the member with the least total distance to the others first, and the others after it by
/// their distance to it.
fn recentre(all: &[Different], members: &mut [usize]) {
    // More than enough to tell the middle; the rest would cost the square of the group.
    const CANDIDATES_MAX: usize = 400;
    let stride = members.len().div_ceil(CANDIDATES_MAX).max(1);
    let candidates: Vec<usize> = members.iter().copied().step_by(stride).collect();
    let total = |candidate: &usize| -> f64 {
        let from = Relative::from(&all[*candidate]);
        candidates
            .iter()
            .map(|other| all[*other].members.len() as f64 * from.to(&all[*other]))
            .sum()
    };
    let Some(medoid) = candidates
        .iter()
        .copied()
        .map(|candidate| (total(&candidate), candidate))
        .min_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)))
        .map(|(_, candidate)| candidate)
    else {
        return;
    };
    let from = Relative::from(&all[medoid]);
    let mut keyed: Vec<(bool, f64, usize)> = members
        .iter()
        .map(|member| (*member != medoid, from.to(&all[*member]), *member))
        .collect();
    keyed.sort_by(|(a, b, c), (x, y, z)| a.cmp(x).then(b.total_cmp(y)).then(c.cmp(z)));
    for (member, (.., sorted)) in members.iter_mut().zip(keyed) {
        *member = sorted;
    }
}
