//! How work is divided: into parts that foreseeably take equally long.

use std::{ops::Range, time::Instant};

use serde::{Deserialize, Serialize};

use crate::{
    BakeOptions, Error, Result,
    bake::{Outlined, ROWS_A_BLOCK, Shared},
    estimate,
    reconstruct::{Field, Stencils},
    simplify::Simplified,
    transfer::{self, Casting},
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
const MOST_SHARDS: usize = 1_000_000;
/// Least share of a shard's time that is its own work where [`Division::Seconds`] asks for shards that hardly begin.
const LEAST_WORK: f64 = 0.1;

/// Work that is timed, of rows and of points: this share of all.
const SHARE: f64 = 0.01;
/// In so many places at least, and at most.
const PLACES: [usize; 2] = [12, 512];
/// Neighbours that are timed in one place, of which the middle one counts: the first meets what nobody has asked for lately, as
/// others will not, and the machine may do something else meanwhile.
const TIMED: usize = 3;
/// Seconds for a row without rays.
const EMPTY_ROW: f64 = 1e-7;

/// The work of one shard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Patches whose rows it casts.
    pub patches: Range<u32>,
    /// How long that and its part of the vertices will take on one thread, as far as can be foreseen, seconds.
    pub seconds: f64,
}

/// What each shard does.
pub struct Divided {
    pub shards: Vec<Part>,
    /// Which points' stencils it makes; nothing where shards make none.
    pub points: Vec<Range<usize>>,
}

/// What is to be divided.
pub struct Work<'a> {
    pub simplified: &'a Simplified,
    pub outlined: &'a Outlined,
    pub options: &'a BakeOptions,
}

impl Work<'_> {
    /// Divides rows evenly, and points too.
    ///
    /// # Errors
    /// [`Error::Option`] for no shards, or too many.
    pub fn divided(&self, division: Division) -> Result<Divided> {
        let rows = self.costs_of_rows();
        let points = self.outlined.shared.as_ref().map_or(Vec::new(), |shared| self.costs_of_points(shared));
        let shards = match division {
            Division::Shards(shards) => shards,
            Division::Seconds(seconds) => {
                let work =
                    (rows.iter().sum::<f64>() + points.iter().sum::<f64>()) / rayon::current_num_threads() as f64;
                let left = (seconds - self.outlined.build_seconds).max(LEAST_WORK * seconds);
                (work / left).ceil().max(1.0) as usize
            }
        };
        if !(1..=MOST_SHARDS).contains(&shards) {
            return Err(Error::Option(format!("{shards} shards: there must be from 1 to {MOST_SHARDS}")));
        }
        let blocks = divide(&rows, shards);
        let mut units = divide(&points, blocks.len());
        units.resize(blocks.len(), points.len()..points.len());
        let patches = self.simplified.patches.len();
        let patch = |block: usize| (block * ROWS_A_BLOCK).min(patches) as u32;
        let part = |(blocks, units): (&Range<usize>, &Range<usize>)| {
            let of = |costs: &[f64], range: &Range<usize>| costs[range.clone()].iter().sum::<f64>();
            let seconds = self.outlined.build_seconds + of(&rows, blocks) + of(&points, units);
            Part { patches: patch(blocks.start)..patch(blocks.end), seconds }
        };
        let count = self.outlined.shared.as_ref().map_or(0, |shared| shared.points.len());
        let point = |unit: usize| (unit * Stencils::TOGETHER).min(count);
        Ok(Divided {
            shards: blocks.iter().zip(&units).map(part).collect(),
            points: units.iter().map(|units| point(units.start)..point(units.end)).collect(),
        })
    }

    /// Foreseen seconds of one thread for each block of rows.
    fn costs_of_rows(&self) -> Vec<f64> {
        let Outlined { outline, points, tracer, .. } = self.outlined;
        let (simplified, options) = (self.simplified, self.options);
        let patches = simplified.patches.len();
        let mut is_replicated = vec![false; patches];
        if options.estimate {
            estimate::replicated(patches, options.seed).into_iter().for_each(|i| is_replicated[i as usize] = true);
        }
        let of = |list: &[bool], i: usize| list.get(i).is_some_and(|&is| is);
        let rays = |i: usize| {
            let own = if of(&outline.spared, i) { 0 } else { transfer::row_length(options.rays, of(&outline.few, i)) };
            let replicate = if is_replicated[i] { options.rays } else { 0 };
            if of(&outline.outer, i) { 0 } else { own + replicate }
        };
        let starts: Vec<usize> = (0..patches).step_by(ROWS_A_BLOCK).collect();
        let block = |first: &usize| (*first..patches.min(first + ROWS_A_BLOCK)).map(rays).map(f64::from).sum::<f64>();
        let cast: Vec<f64> = starts.iter().map(block).collect();

        let casting = Casting { marked: true, ..Casting::new(simplified, &**tracer, &outline.outer, points) };
        let count = SHARE * cast.iter().sum::<f64>() / (TIMED as u32 * points.rays()) as f64;
        let seconds_a_ray = |blocks: Range<usize>| {
            let end = starts.get(blocks.end).copied().unwrap_or(patches);
            let some: Vec<u32> = (starts[blocks.start]..end).filter(|&i| rays(i) > 0).map(|i| i as u32).collect();
            median(transfer::seconds_of_rows(&casting, middle(&some))) / points.rays() as f64
        };
        let rates = by_places(cast.len(), count as usize, seconds_a_ray);
        cast.iter().zip(rates).map(|(rays, rate)| rays * rate + ROWS_A_BLOCK as f64 * EMPTY_ROW).collect()
    }

    /// Foreseen seconds of one thread for the stencils of each [`Stencils::TOGETHER`] points.
    fn costs_of_points(&self, shared: &Shared) -> Vec<f64> {
        let units: Vec<_> = shared.points.chunks(Stencils::TOGETHER).collect();
        let seconds = |field: &Field, units: &[_]| {
            let seconds = |unit: &&[_]| {
                let begun = Instant::now();
                Stencils::new(field, unit);
                begun.elapsed().as_secs_f64()
            };
            median(middle(units).iter().map(seconds).collect())
        };
        let count = SHARE * units.len() as f64 / TIMED as f64;
        shared.sight.clone().in_field(self.simplified, &*self.outlined.tracer, self.options, |field| {
            by_places(units.len(), count as usize, |place| seconds(field, &units[place]))
        })
    }
}

/// A value for each of `units`, which one of `measured` gives for all of a stretch of them; of about `count` stretches.
fn by_places(units: usize, count: usize, measured: impl Fn(Range<usize>) -> f64) -> Vec<f64> {
    let stretch = units.div_ceil(count.clamp(PLACES[0], PLACES[1])).max(1);
    let of = |first: usize| {
        let place = first..units.min(first + stretch);
        std::iter::repeat_n(measured(place.clone()), place.len())
    };
    (0..units).step_by(stretch).flat_map(of).collect()
}

/// Neighbours in the middle of these.
fn middle<T>(all: &[T]) -> &[T] {
    let first = all.len().saturating_sub(TIMED) / 2;
    &all[first..all.len().min(first + TIMED)]
}

/// The middle one; 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Divides work of these `costs` into so many runs of nearly equal cost, in order; none is empty if there are enough.
fn divide(costs: &[f64], runs: usize) -> Vec<Range<usize>> {
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

    proptest! {
        #[test]
        fn every_unit_has_the_value_of_a_place_that_it_lies_in(units in 0..5000_usize, count in 0..1000_usize) {
            let values = by_places(units, count, |place| (place.start * 10_000 + place.end) as f64);
            prop_assert_eq!(values.len(), units);
            let place = |value: f64| (value as usize / 10_000)..(value as usize % 10_000);
            prop_assert!(values.iter().enumerate().all(|(unit, &value)| place(value).contains(&unit)));
            let places = values.iter().map(|&value| place(value).start).collect::<std::collections::HashSet<_>>().len();
            // Stretches are of a whole number of units: so there may be half as many.
            prop_assert!(places <= PLACES[1] && places >= units.min(count.clamp(PLACES[0], PLACES[1])) / 2);
        }
    }

    #[test]
    fn neighbours_that_are_timed_lie_in_the_middle_and_the_middle_one_counts() {
        assert_eq!(middle(&[1, 2, 3, 4, 5, 6]), [2, 3, 4]);
        assert_eq!(middle(&[1, 2]), [1, 2]);
        assert!(middle::<u32>(&[]).is_empty());
        assert_eq!(median(vec![9.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![]), 0.0);
    }

    #[test]
    fn work_that_costs_nothing_is_divided_too() {
        assert_eq!(divide(&[0.0; 4], 2).iter().map(Range::len).sum::<usize>(), 4);
        assert!(divide(&[], 3).iter().all(Range::is_empty));
    }
}
