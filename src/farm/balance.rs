//! How work is divided: into parts that foreseeably take equally long.

use std::ops::Range;

use crate::{
    bake::ROWS_A_BLOCK,
    transfer::{self, Casting, TIMED},
};

/// Into how many shards work is divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Division {
    /// So many; fewer if there are not as many blocks of rows.
    Shards(usize),
    /// As many as that each takes about this long on all threads of a machine like this one, seconds.
    Seconds(f64),
}

/// Most shards of a plan.
pub const MOST_SHARDS: usize = 1_000_000;

/// Rays of a row that is timed, at most: in a long row a ray takes nearly as long.
pub const SAMPLE_RAYS: u32 = 256;
/// Rows that are timed: this share of all rays, within these bounds.
const SHARE: f64 = 0.005;
const LEAST: usize = 32;
const MOST: usize = 256;
/// Seconds for a row without rays.
const EMPTY_ROW: f64 = 1e-7;

/// Foreseen seconds of one thread for each block of successive patches; `rays` is how many are cast of a patch, and `casting`
/// is how rows are timed: they need not be as long.
pub fn costs(casting: &Casting, rays: impl Fn(u32) -> u32) -> Vec<f64> {
    let n = casting.simplified.patches.len() as u32;
    let blocks: Vec<Range<u32>> =
        (0..n).step_by(ROWS_A_BLOCK).map(|first| first..n.min(first + ROWS_A_BLOCK as u32)).collect();
    let cast: Vec<u64> = blocks.iter().map(|block| block.clone().map(|i| rays(i) as u64).sum()).collect();
    // In each stretch of blocks the middle one of the patches that cast rays stands for all.
    let all = cast.iter().sum::<u64>() as f64;
    let count = (SHARE * all / (TIMED * casting.points.rays()) as f64) as usize;
    let stretch = blocks.len().div_ceil(count.clamp(LEAST, MOST)).max(1);
    let sample: Vec<Option<u32>> = blocks
        .chunks(stretch)
        .map(|blocks| {
            let casting: Vec<u32> = blocks.iter().cloned().flatten().filter(|&i| rays(i) > 0).collect();
            casting.get(casting.len() / 2).copied()
        })
        .collect();
    let timed: Vec<u32> = sample.iter().copied().flatten().collect();
    let mut seconds = transfer::seconds_a_ray(casting, &timed).into_iter();
    let seconds: Vec<f64> = sample.iter().map(|patch| patch.and_then(|_| seconds.next()).unwrap_or(0.0)).collect();
    let empty = ROWS_A_BLOCK as f64 * EMPTY_ROW;
    cast.iter().enumerate().map(|(b, &rays)| rays as f64 * seconds[b / stretch] + empty).collect()
}

/// Divides work of these `costs` into so many runs of nearly equal cost, in order; none is empty if there are enough.
pub fn divide(costs: &[f64], runs: usize) -> Vec<Range<usize>> {
    let runs = runs.clamp(1, costs.len().max(1));
    let total: f64 = costs.iter().sum();
    let (mut begin, mut sum) = (0, 0.0);
    let run = |k: usize| {
        // Each of those that are left gets one at least.
        let (first, most) = (begin, costs.len() - (runs - 1 - k));
        let goal = total * (k + 1) as f64 / runs as f64;
        while begin < most && (begin == first || k + 1 == runs || sum + 0.5 * costs[begin] <= goal) {
            sum += costs[begin];
            begin += 1;
        }
        first..begin
    };
    (0..runs).map(run).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn runs_are_in_order_complete_and_nearly_equal(costs in prop::collection::vec(0.0..1.0_f64, 1..200), runs in 1..50_usize) {
            let divided = divide(&costs, runs);
            prop_assert_eq!(divided.len(), runs.min(costs.len()));
            prop_assert_eq!(divided.iter().cloned().flatten().collect::<Vec<_>>(), (0..costs.len()).collect::<Vec<_>>());
            prop_assert!(divided.iter().all(|run| !run.is_empty()));
            let cost = |run: &Range<usize>| costs[run.clone()].iter().sum::<f64>();
            let mean = costs.iter().sum::<f64>() / divided.len() as f64;
            // Each end is off by half of a cost at most, if there are many more costs than runs.
            if costs.len() > 8 * runs {
                let most = divided.iter().map(cost).fold(0.0, f64::max);
                prop_assert!(most <= mean + 1.0 + 1e-9, "{} of {}", most, mean);
            }
        }
    }

    #[test]
    fn work_that_costs_nothing_is_divided_too() {
        assert_eq!(divide(&[0.0; 4], 2).iter().map(Range::len).sum::<usize>(), 4);
        assert!(divide(&[], 3).iter().all(Range::is_empty));
    }
}
