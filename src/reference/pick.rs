//! Picks one of many with given probabilities, in constant time (the alias method, Walker 1977; Vose 1991).

/// A table of choices.
pub(super) struct Pick {
    choices: Vec<Choice>,
    probabilities: Vec<f64>,
}

#[derive(Clone, Copy)]
struct Choice {
    /// Below this share of the cell it is the cell's own choice, else the other.
    threshold: f32,
    own_width: f32,
    other_width: f32,
    other: u32,
}

impl Pick {
    /// `probabilities` sum to 1 (to rounding).
    pub fn new(probabilities: &[f64]) -> Pick {
        let n = probabilities.len();
        let mut scaled: Vec<f64> = probabilities.iter().map(|p| p * n as f64).collect();
        let mut thresholds = vec![1.0_f64; n];
        let mut others: Vec<u32> = (0..n as u32).collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..n).partition(|&i| scaled[i] < 1.0);
        while let (Some(s), Some(&l)) = (small.pop(), large.last()) {
            thresholds[s] = scaled[s];
            others[s] = l as u32;
            scaled[l] -= 1.0 - scaled[s];
            if scaled[l] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        let choice = |i: usize| {
            let threshold = thresholds[i] as f32;
            Choice { threshold, own_width: 1.0 / threshold, other_width: 1.0 / (1.0 - threshold), other: others[i] }
        };
        let choices: Vec<Choice> = (0..n).map(choice).collect();
        // What the table gives, rounding included.
        let mut given = vec![0.0; n];
        for (i, c) in choices.iter().enumerate() {
            given[i] += c.threshold as f64 / n as f64;
            given[c.other as usize] += (1.0 - c.threshold as f64) / n as f64;
        }
        Pick { choices, probabilities: given }
    }

    /// The probability of choice `i`.
    pub fn probability(&self, i: usize) -> f64 {
        self.probabilities[i]
    }

    /// A choice by a random word, and a number in [0, 1) that is left of it. None if there is nothing to choose.
    #[inline]
    pub fn pick(&self, u: u32) -> Option<(u32, f32)> {
        let place = u as u64 * self.choices.len() as u64;
        let (cell, rest) = ((place >> 32) as usize, super::numbers::fraction(place as u32));
        let c = self.choices.get(cell)?;
        Some(if rest < c.threshold {
            (cell as u32, (rest * c.own_width).min(BELOW_ONE))
        } else {
            (c.other, ((rest - c.threshold) * c.other_width).min(BELOW_ONE))
        })
    }
}

/// The largest f32 below one.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_come_as_often_as_their_probability_and_leave_even_numbers() {
        let probabilities = [0.5, 0.01, 0.29, 0.0, 0.2];
        let pick = Pick::new(&probabilities);
        let n = 1 << 20;
        let (mut counts, mut sums) = ([0.0; 5], [0.0_f64; 5]);
        for i in 0..n as u64 {
            let (choice, rest) = pick.pick(((2 * i + 1) << 11) as u32).unwrap();
            assert!((0.0..1.0).contains(&rest));
            counts[choice as usize] += 1.0 / n as f64;
            sums[choice as usize] += rest as f64 / n as f64;
        }
        for (k, p) in probabilities.into_iter().enumerate() {
            // A choice is a few intervals of u, each with two ends.
            assert!((counts[k] - p).abs() < 20.0 / n as f64, "{k}: {}", counts[k]);
            assert!((pick.probability(k) - p).abs() < 1e-6);
            assert!((sums[k] - 0.5 * p).abs() < 20.0 / n as f64, "{k}");
        }
        assert!(Pick::new(&[]).pick(7).is_none());
    }
}
