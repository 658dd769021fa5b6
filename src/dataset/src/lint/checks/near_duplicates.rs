//! Near-duplicates: rows whose words are almost those of another (MinHash over word triples,
//! bands of locality-sensitive hashing).
//!
//! Why: they weigh like copies. Lines that half of the first rows share (tools, instructions)
//! are left out, and rows of one episode are not compared: each continues the one before.
//! Sure: the similarity is an estimate within some 0.05; a pair at the threshold is found with
//! a probability of about one half, one well above it almost surely. A row is compared with
//! the last [`crate::lint::LintOptions::near_rows_max`] rows. Memory: constant, some 700 bytes
//! for each of those.

use std::{
    collections::{HashMap, HashSet},
    hash::{BuildHasher, BuildHasherDefault, DefaultHasher},
};

use super::{Check, RowFacts, row_facts::Key};
use crate::lint::{Part, RowLocation, Severity, report::Findings};

/// Values of a signature; the error of the estimate is about `sqrt(s (1 - s) / HASHES)`.
const HASHES: usize = 128;
/// Values of a band: all must be equal for two rows to be compared.
const BAND: usize = 6;
const BANDS: usize = HASHES / BAND;
/// Words of a shingle.
const SHINGLE: usize = 3;
/// Rows that are held back to learn which lines all rows share.
const ROWS_LEARNED: usize = 256;
/// Below this many shingles a row is too short to be like another.
const SHINGLES_MIN: usize = 8;

type Signature = [u32; HASHES];

pub(super) struct NearDuplicates {
    similarity_min: f64,
    rows_max: usize,
    /// The last rows, over and over.
    rows: Vec<SignatureRow>,
    next: usize,
    /// For each band and bucket the number in `rows` of the last row there, plus one.
    buckets: Vec<u32>,
    mask: usize,
    learning: Vec<PendingRow>,
    /// Hashes of lines that all rows share.
    common: HashSet<u64>,
    learned: bool,
}

struct SignatureRow {
    signature: Signature,
    place: RowLocation,
    episode: u64,
    whole: Key,
}

struct PendingRow {
    lines: Vec<(u64, Vec<u32>)>,
    place: RowLocation,
    episode: u64,
    whole: Key,
    excerpt: String,
}

impl NearDuplicates {
    pub(super) fn new(similarity_min: f64, rows_max: usize) -> Self {
        let rows_max = rows_max.clamp(1, 1 << 24);
        let buckets = rows_max.next_power_of_two();
        Self {
            similarity_min,
            rows_max,
            rows: Vec::new(),
            next: 0,
            buckets: Vec::new(),
            mask: buckets - 1,
            learning: Vec::new(),
            common: HashSet::new(),
            learned: false,
        }
    }

    /// Which lines half of the first rows share; then these rows are compared.
    fn learn(&mut self, found: &mut Findings) {
        self.learned = true;
        let mut counts: HashMap<u64, usize> = HashMap::new();
        for row in &self.learning {
            let lines: HashSet<u64> = row.lines.iter().map(|(line, _)| *line).collect();
            lines
                .into_iter()
                .for_each(|line| *counts.entry(line).or_default() += 1);
        }
        let enough = (self.learning.len() / 2).max(8);
        self.common = counts
            .into_iter()
            .filter(|(_, count)| *count > enough)
            .map(|(line, _)| line)
            .collect();
        for row in std::mem::take(&mut self.learning) {
            self.compare(row, found);
        }
    }

    fn compare(&mut self, row: PendingRow, found: &mut Findings) {
        let words = row
            .lines
            .into_iter()
            .filter(|(line, _)| !self.common.contains(line))
            .flat_map(|(_, words)| words);
        let Some(signature) = signature(&words.collect::<Vec<u32>>()) else {
            return;
        };
        if self.buckets.is_empty() {
            self.buckets = vec![0; BANDS * (self.mask + 1)];
        }
        let mut best: Option<(f64, RowLocation)> = None;
        let mut seen = [0_u32; BANDS];
        for band in 0..BANDS {
            let values = &signature[band * BAND..(band + 1) * BAND];
            let hash = values
                .iter()
                .fold(band as u64, |hash, value| mixed(hash ^ u64::from(*value)));
            let bucket = &mut self.buckets[band * (self.mask + 1) + (hash as usize & self.mask)];
            let candidate = std::mem::replace(bucket, u32::try_from(self.next + 1).unwrap_or(0));
            seen[band] = candidate;
            let Some(other) = usize::try_from(candidate)
                .ok()
                .and_then(|it| it.checked_sub(1))
                .and_then(|it| self.rows.get(it))
            else {
                continue;
            };
            let same_episode = row.episode != 0 && row.episode == other.episode;
            if seen[..band].contains(&candidate) || same_episode || other.whole == row.whole {
                continue;
            }
            let equal = signature
                .iter()
                .zip(&other.signature)
                .filter(|(a, b)| a == b)
                .count();
            let similarity = equal as f64 / HASHES as f64;
            if similarity >= self.similarity_min && best.is_none_or(|(best, _)| similarity > best) {
                best = Some((similarity, other.place));
            }
        }
        if let Some((similarity, place)) = best {
            let told = format!("{:.0}% like an earlier row", 100.0 * similarity);
            found.add("near", Severity::Warning, &[row.place, place], || {
                (told, row.excerpt.clone())
            });
        }
        let kept = SignatureRow {
            signature,
            place: row.place,
            episode: row.episode,
            whole: row.whole,
        };
        if self.rows.len() < self.rows_max {
            self.rows.push(kept);
        } else {
            self.rows[self.next] = kept;
        }
        self.next = (self.next + 1) % self.rows_max;
    }
}

impl Check for NearDuplicates {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "near-duplicates",
            "rows that are almost the same as a row of another episode",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let hasher = BuildHasherDefault::<DefaultHasher>::default();
        let mut lines = Vec::new();
        for part in seen.example.turns.iter().flat_map(|turn| &turn.parts) {
            let said;
            let text = match part {
                Part::Text(text) => text.as_str(),
                Part::Call(call) => {
                    said = call.canonical();
                    &said
                }
                Part::Image(_) => continue,
            };
            for line in text.lines() {
                let hash = hasher.hash_one(line);
                if self.learned && self.common.contains(&hash) {
                    continue;
                }
                let words = line
                    .split(|c: char| !c.is_alphanumeric())
                    .filter(|word| !word.is_empty());
                lines.push((
                    hash,
                    words
                        .map(|word| (hasher.hash_one(word) >> 32) as u32)
                        .collect(),
                ));
            }
        }
        let episode = seen
            .example
            .episode()
            .map_or(0, |episode| hasher.hash_one(episode));
        let excerpt = seen
            .example
            .turns
            .iter()
            .rev()
            .find(|turn| turn.role.is_answer())
            .map(|turn| turn.text());
        let excerpt = excerpt.unwrap_or_default().chars().take(240).collect();
        let row = PendingRow {
            lines,
            place: seen.place(),
            episode,
            whole: seen.whole,
            excerpt,
        };
        if self.learned {
            self.compare(row, found);
            return;
        }
        self.learning.push(row);
        if self.learning.len() == ROWS_LEARNED {
            self.learn(found);
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        if !self.learned {
            self.learn(found);
        }
        found.note(format!(
            "similarity from {:.0}%, each with the last {} rows",
            100.0 * self.similarity_min,
            self.rows_max
        ));
    }
}

/// The least hash of all shingles under each of [`HASHES`] permutations.
fn signature(words: &[u32]) -> Option<Signature> {
    if words.len() < SHINGLES_MIN + SHINGLE - 1 {
        return None;
    }
    let mut signature = [u32::MAX; HASHES];
    let mut shingles: Vec<u32> = words.windows(SHINGLE).map(shingle).collect();
    shingles.sort_unstable();
    shingles.dedup();
    for shingle in shingles {
        for (value, (multiply, add)) in signature.iter_mut().zip(&PERMUTATIONS) {
            *value = (*value).min(spread(shingle.wrapping_mul(*multiply).wrapping_add(*add)));
        }
    }
    Some(signature)
}

fn shingle(words: &[u32]) -> u32 {
    (words
        .iter()
        .fold(0, |hash, word| mixed(hash ^ u64::from(*word)))
        >> 32) as u32
}

/// A permutation of 32 bits: without it the least values of linear maps are not independent enough.
fn spread(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^ (x >> 15)
}

/// Multipliers (odd) and summands, fixed so that equal data gives equal reports.
const PERMUTATIONS: [(u32, u32); HASHES] = {
    let mut table = [(1, 0); HASHES];
    let mut state = 1;
    let mut number = 0;
    while number < HASHES {
        state = mixed(state);
        table[number] = ((state >> 32) as u32 | 1, state as u32);
        number += 1;
    }
    table
};

/// Mixes a 64-bit number as one step of the SplitMix64 generator does.
const fn mixed(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}
