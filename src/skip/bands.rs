//! Channels that are equal are solved once.

use crate::{
    solve::{self, Solution},
    transfer::FormFactors,
};

/// Solves B = S + rho F B as [`solve::solve`] does, each of the distinct channels once: the same bits. Tells how many
/// there are.
///
/// Channels are equal if albedo and source are, at every patch: grey scenes have one, and so have two dark channels.
pub fn solve(
    f: &FormFactors,
    albedo: &[[f64; 3]],
    source: &[[f64; 3]],
    tolerance: f64,
    spilled: bool,
) -> (Solution, usize) {
    let equal = |a: usize, b: usize| {
        let same = |x: &[[f64; 3]]| x.iter().all(|x| x[a].to_bits() == x[b].to_bits());
        same(source) && same(albedo)
    };
    // The channel that stands for each.
    let first = [0, if equal(0, 1) { 0 } else { 1 }, if equal(0, 2) { 0 } else { 2 }];
    let first = if first == [0, 1, 2] && equal(1, 2) { [0, 1, 1] } else { first };
    match first {
        [0, 0, 0] => (some::<1>(f, albedo, source, (tolerance, spilled), [0], [0, 0, 0]), 1),
        [0, 0, 2] => (some::<2>(f, albedo, source, (tolerance, spilled), [0, 2], [0, 0, 1]), 2),
        [0, 1, 0] => (some::<2>(f, albedo, source, (tolerance, spilled), [0, 1], [0, 1, 0]), 2),
        [0, 1, 1] => (some::<2>(f, albedo, source, (tolerance, spilled), [0, 1], [0, 1, 1]), 2),
        _ => (solve::solve(f, albedo, source, tolerance, spilled), 3),
    }
}

/// Solves the channels `of`; `place` tells where each of the three is among them.
fn some<const N: usize>(
    f: &FormFactors,
    albedo: &[[f64; 3]],
    source: &[[f64; 3]],
    (tolerance, spilled): (f64, bool),
    of: [usize; N],
    place: [usize; 3],
) -> Solution {
    let take = |x: &[[f64; 3]]| x.iter().map(|x| of.map(|c| x[c])).collect::<Vec<[f64; N]>>();
    let s = solve::solve(f, &take(albedo), &take(source), tolerance, spilled);
    let all = |x: Vec<[f64; N]>| x.into_iter().map(|x| place.map(|c| x[c])).collect();
    Solution {
        radiosity: all(s.radiosity),
        irradiance: all(s.irradiance),
        iterations: s.iterations,
        residual: s.residual,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::hash;

    fn unit(i: u64, k: u64) -> f64 {
        (hash(&[i, k]) >> 11) as f64 / (1u64 << 53) as f64
    }

    #[test]
    fn equal_channels_are_solved_once_with_the_same_bits() {
        let n = 200;
        let rows: Vec<(Vec<u32>, u32)> =
            (0..n).map(|i| ((0..n).map(|j| (hash(&[i, j]) % 4) as u32).collect(), (i % 7) as u32)).collect();
        let f = FormFactors::of_hits(&rows);
        for (channels, distinct) in [([0, 0, 0], 1), ([0, 0, 1], 2), ([0, 1, 0], 2), ([1, 0, 0], 2), ([0, 1, 2], 3)] {
            let albedo: Vec<[f64; 3]> = (0..n).map(|i| channels.map(|c| 0.9 * unit(i, 10 + c))).collect();
            let source: Vec<[f64; 3]> = (0..n).map(|i| channels.map(|c| unit(i, 20 + c))).collect();
            let (some, count) = solve(&f, &albedo, &source, 1e-9, false);
            let all = solve::solve(&f, &albedo, &source, 1e-9, false);
            assert_eq!(count, distinct);
            assert_eq!((some.iterations, some.residual), (all.iterations, all.residual));
            assert!(some.radiosity == all.radiosity && some.irradiance == all.irradiance, "{channels:?}");
        }
    }
}
