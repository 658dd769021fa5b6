//! The edit distance of two sequences of symbols, bit-parallel. Knows nothing of calls.

/// Levenshtein distance: insertions, deletions and substitutions. Sequences of up to 64 symbols
/// take one machine word a column (Myers 1999, in Hyyrö's form); longer ones the plain table.
pub fn edit_distance(one: &[u16], other: &[u16]) -> u32 {
    let (short, long) = if one.len() <= other.len() {
        (one, other)
    } else {
        (other, one)
    };
    match short.len() {
        0 => long.len() as u32,
        1..=64 => bit_parallel(short, long),
        _ => table(short, long),
    }
}

fn bit_parallel(pattern: &[u16], text: &[u16]) -> u32 {
    let mut positions: Vec<(u16, u64)> = Vec::with_capacity(pattern.len());
    for (index, symbol) in pattern.iter().enumerate() {
        let bit = 1_u64 << index;
        match positions.iter_mut().find(|(known, _)| known == symbol) {
            Some((_, mask)) => *mask |= bit,
            None => positions.push((*symbol, bit)),
        }
    }
    let last = 1_u64 << (pattern.len() - 1);
    let (mut plus, mut minus) = (u64::MAX, 0_u64);
    let mut distance = pattern.len() as u32;
    for symbol in text {
        let equal = positions
            .iter()
            .find(|(known, _)| known == symbol)
            .map_or(0, |(_, mask)| *mask);
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
                edit_distance(&one, &other),
                table(&one, &other),
                "{one:?} {other:?}"
            );
        }
        let symbols = |text: &str| text.bytes().map(u16::from).collect::<Vec<_>>();
        assert_eq!(edit_distance(&symbols("kitten"), &symbols("sitting")), 3);
        assert_eq!(edit_distance(&symbols(""), &symbols("abc")), 3);
    }
}
