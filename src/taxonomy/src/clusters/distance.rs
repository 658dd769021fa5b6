//! The edit distance of sequences of symbols, bit-parallel. Knows nothing of calls.

/// A sequence that others are compared with: what each symbol's positions are is worked out once.
pub struct EditDistance<'s> {
    symbols: &'s [u16],
    /// By symbol, the positions at which it stands, as bits; empty for sequences that are longer
    /// than a machine word.
    positions: Vec<u64>,
}

impl<'s> EditDistance<'s> {
    /// Prepares a sequence of symbols.
    pub fn from(symbols: &'s [u16]) -> Self {
        let mut positions = Vec::new();
        if symbols.len() <= 64 {
            let kinds = symbols
                .iter()
                .max()
                .map_or(0, |most| usize::from(*most) + 1);
            positions = vec![0; kinds];
            for (index, symbol) in symbols.iter().enumerate() {
                positions[usize::from(*symbol)] |= 1 << index;
            }
        }
        Self { symbols, positions }
    }

    /// Levenshtein distance to another sequence: insertions, deletions and substitutions. Where the
    /// prepared one has up to 64 symbols it takes one machine word a symbol of the other (Myers
    /// 1999, in Hyyrö's form), otherwise the plain table.
    pub fn to(&self, other: &[u16]) -> u32 {
        match self.symbols.len() {
            0 => other.len() as u32,
            1..=64 => self.bit_parallel(other),
            _ => table(self.symbols, other),
        }
    }

    fn bit_parallel(&self, text: &[u16]) -> u32 {
        let last = 1_u64 << (self.symbols.len() - 1);
        let (mut plus, mut minus) = (u64::MAX, 0_u64);
        let mut distance = self.symbols.len() as u32;
        for symbol in text {
            let equal = self
                .positions
                .get(usize::from(*symbol))
                .copied()
                .unwrap_or(0);
            let diagonal = ((equal & plus).wrapping_add(plus) ^ plus) | equal | minus;
            let mut up = minus | !(diagonal | plus);
            let mut down = plus & diagonal;
            distance += u32::from(up & last != 0);
            distance -= u32::from(down & last != 0);
            up = (up << 1) | 1;
            down <<= 1;
            plus = down | !(diagonal | up);
            minus = up & diagonal;
        }
        distance
    }
}

fn table(one: &[u16], other: &[u16]) -> u32 {
    let mut row: Vec<u32> = (0..=other.len() as u32).collect();
    for (index, symbol) in one.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = index as u32 + 1;
        for (column, with) in other.iter().enumerate() {
            let changed = diagonal + u32::from(symbol != with);
            diagonal = row[column + 1];
            row[column + 1] = changed.min(diagonal + 1).min(row[column] + 1);
        }
    }
    row[other.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_to_compute_it_agree() {
        // A fixed linear congruence: every run tests the same sequences.
        let mut state = 1_u32;
        let mut next = |bound: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) % bound
        };
        for _ in 0..2_000 {
            let lengths = [next(70), next(70)];
            let [one, other] =
                lengths.map(|length| (0..length).map(|_| next(5) as u16).collect::<Vec<_>>());
            assert_eq!(
                EditDistance::from(&one).to(&other),
                table(&one, &other),
                "{one:?} {other:?}"
            );
        }
        let symbols = |text: &str| text.bytes().map(u16::from).collect::<Vec<_>>();
        for (one, other) in [("kitten", "sitting"), ("", "abc"), ("abc", "")] {
            assert_eq!(EditDistance::from(&symbols(one)).to(&symbols(other)), 3);
        }
    }
}
