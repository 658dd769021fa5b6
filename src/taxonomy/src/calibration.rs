//! Whether a stated confidence is worth its number: of answers given with 0.8, are 80% right? Brier
//! score (Brier 1950) and expected calibration error over bins of equal width (Naeini et al. 2015).

use serde::Serialize;

/// Bins between 0 and 1: few, because few episodes have labels.
const BINS: usize = 5;

/// How confidence and being right go together.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Calibration {
    /// Answers with a confidence.
    pub answers: usize,
    /// Share of them that is right.
    pub accuracy: f64,
    /// Mean squared distance between the confidence and being right (1) or wrong (0); 0 is best,
    /// and always saying 0.5 gives 0.25.
    pub brier: f64,
    /// Brier score of one who always states the share that is right: what a confidence that says
    /// nothing about the single answer comes to.
    pub brier_baseline: f64,
    /// Mean distance between confidence and share of right answers in a bin, by answers.
    pub expected_error: f64,
    /// The bins that have answers, by rising confidence.
    pub bins: Vec<CalibrationBin>,
}

/// Answers of about the same confidence.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct CalibrationBin {
    /// Lowest and highest confidence that the bin takes.
    pub range: [f64; 2],
    /// How many answers the bin has.
    pub answers: usize,
    /// Mean confidence of these answers.
    pub confidence: f64,
    /// Share of them that is right.
    pub accuracy: f64,
}

/// The calibration of answers: confidence, from 0 to 1, and whether each is right. `None` where
/// there are none.
pub fn calibration(answers: &[(f64, bool)]) -> Option<Calibration> {
    if answers.is_empty() {
        return None;
    }
    let total = answers.len() as f64;
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / total;
    let accuracy = mean(&mut answers.iter().map(|(_, right)| f64::from(u8::from(*right))));
    let squares = answers.iter().map(|(confidence, right)| {
        let off = confidence - f64::from(u8::from(*right));
        off * off
    });
    let brier = mean(&mut { squares });
    let mut bins = Vec::new();
    let mut expected_error = 0.0;
    for bin in 0..BINS {
        let [low, high] = [bin, bin + 1].map(|edge| edge as f64 / BINS as f64);
        let within: Vec<&(f64, bool)> = answers
            .iter()
            .filter(|(confidence, _)| *confidence >= low && (*confidence < high || bin + 1 == BINS))
            .collect();
        if within.is_empty() {
            continue;
        }
        let count = within.len() as f64;
        let confidence = within.iter().map(|(confidence, _)| confidence).sum::<f64>() / count;
        let right = within.iter().filter(|(_, right)| *right).count() as f64 / count;
        expected_error += (confidence - right).abs() * count / total;
        bins.push(CalibrationBin {
            range: [low, high],
            answers: within.len(),
            confidence,
            accuracy: right,
        });
    }
    Some(Calibration {
        answers: answers.len(),
        accuracy,
        brier,
        brier_baseline: accuracy * (1.0 - accuracy),
        expected_error,
        bins,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figures_are_those_of_a_computation_by_hand() {
        // 0.9 right, 0.9 wrong, 0.3 wrong, 1.0 right
        let answers = [(0.9, true), (0.9, false), (0.3, false), (1.0, true)];
        let found = calibration(&answers).unwrap();
        assert_eq!((found.answers, found.accuracy), (4, 0.5));
        // (0.01 + 0.81 + 0.09 + 0) / 4
        assert!((found.brier - 0.2275).abs() < 1e-12);
        assert_eq!(found.brier_baseline, 0.25);
        let bins: Vec<_> = found
            .bins
            .iter()
            .map(|bin| (bin.range, bin.answers))
            .collect();
        assert_eq!(bins, [([0.2, 0.4], 1), ([0.8, 1.0], 3)]);
        // |0.3 - 0| / 4 + |2.8 / 3 - 2 / 3| * 3 / 4
        assert!((found.expected_error - (0.075 + 0.2)).abs() < 1e-12);
    }

    #[test]
    fn who_is_sure_and_right_is_calibrated() {
        let found = calibration(&[(1.0, true), (0.0, false)]).unwrap();
        assert_eq!((found.brier, found.expected_error), (0.0, 0.0));
        assert_eq!(calibration(&[]), None);
    }
}
