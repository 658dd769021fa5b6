//! Groups sequences around medoids by a threshold on their distance. Never draws at random: equal
//! sequences give equal groups, whatever their order.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::{CallKind, CallSequence, distance::edit_distance};

/// Different sequences whose distances are all computed; of more a sample decides the medoids.
pub const SAMPLE_MAX: usize = 2_000;

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
/// with it, until none is left; then each goes to its nearest medoid, and each group's medoid becomes
/// the member with the least total distance.
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
            let medoid = &all[members[0]];
            let mut indices: Vec<(usize, f64)> = Vec::new();
            for member in members {
                let distance = relative(&medoid.symbols, &all[*member].symbols);
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

fn relative(one: &[u16], other: &[u16]) -> f64 {
    let longest = one.len().max(other.len()).max(1);
    f64::from(edit_distance(one, other)) / longest as f64
}

/// For each of the sample which others, itself included, are within the threshold.
fn neighbours(all: &[Different], sample: &[usize], threshold: f64) -> Vec<Vec<u32>> {
    let near = |index: &usize| {
        let symbols = &all[*index].symbols;
        let is_near = |other: &usize| {
            let other = &all[*other].symbols;
            let longest = symbols.len().max(other.len()).max(1) as f64;
            // The difference of the lengths is a lower bound.
            symbols.len().abs_diff(other.len()) as f64 <= threshold * longest
                && relative(symbols, other) <= threshold
        };
        (0..sample.len() as u32)
            .filter(|other| is_near(&sample[*other as usize]))
            .collect()
    };
    sample.par_iter().map(near).collect()
}

/// Each sequence beside its nearest medoid; one that is near none of them is alone.
fn assign(all: &[Different], medoids: &[usize], threshold: f64) -> Vec<Vec<usize>> {
    let nearest = |index: usize| {
        let distance = |medoid: &usize| relative(&all[*medoid].symbols, &all[index].symbols);
        let best = medoids
            .iter()
            .enumerate()
            .map(|(position, medoid)| (distance(medoid), position))
            .min_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)))?;
        (best.0 <= threshold).then_some(best.1)
    };
    let found: Vec<Option<usize>> = (0..all.len()).into_par_iter().map(nearest).collect();
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
        candidates
            .iter()
            .map(|other| {
                let weight = all[*other].members.len() as f64;
                weight * relative(&all[*candidate].symbols, &all[*other].symbols)
            })
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
    let distance = |member: usize| relative(&all[medoid].symbols, &all[member].symbols);
    members.sort_by(|one, other| {
        let key = |member: usize| (member != medoid, distance(member), member);
        let ((a, b, c), (x, y, z)) = (key(*one), key(*other));
        a.cmp(&x).then(b.total_cmp(&y)).then(c.cmp(&z))
    });
}
