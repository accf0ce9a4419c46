//! Which patches are reached by light, and so which rows are needed.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::{
    FormFactors, RowKeeper, RowPoints, Rows, View,
    cast::{Casting, cast},
    caster::{Caster, Probe, Seen},
};
use crate::{
    Result,
    progress::{self, Progress},
    simplify::Simplified,
    trace::RayTracer,
};

/// Form factors and what was learnt on the way.
pub struct Estimate {
    /// The matrix.
    pub form_factors: FormFactors,
    /// Whether light reaches each patch.
    pub reached: Vec<bool>,
    /// Whether any ray of the patch started outside of objects.
    pub visible: Vec<bool>,
    /// Whether an unreached patch sees out of the scene, as far as its probe tells.
    pub outside: Vec<bool>,
    /// Whether the row of a patch has fewer rays, because it matters less.
    pub few: Vec<bool>,
    /// Rays that were cast, probes among them; rows that were known are not.
    pub rays: u64,
    /// Rays of patches that nothing lies before: they were not cast.
    pub clear: u64,
}

/// Which rows are needed.
#[derive(Clone, Copy, Default)]
pub struct Plan<'a> {
    /// Patches that rows start from: those that light starts from; with `backwards`, those whose light is wanted.
    pub start: &'a [bool],
    /// Whether every row is cast, and kept.
    pub all: bool,
    /// Whether rows follow what matters to `start` instead of what light reaches. Patches that no row of `start` sees
    /// much of get fewer rays.
    pub backwards: bool,
    /// Patches whose rows matter only if they are in `start`. Empty: none.
    pub black: &'a [bool],
}

/// A patch is of little importance if none of the wanted ones sends it more than a 64th of its rays.
const SEEN_LITTLE: u32 = 64;

/// Estimates the rows of all patches that light can reach.
///
/// Light starts at the patches in `lit`. What their rays meet may be lit too, and so on to closure: rows are cast in
/// waves, so finding out what is reached costs hardly a ray. A patch is reached if its own row meets a reached patch,
/// for else its irradiance is zero in any case. A single such ray does not count unless the row of a reached patch
/// meets the patch too, because where surfaces touch, rounding puts about one hit in a million on the wrong side. At
/// last each patch that was not met looks for light itself with the leading 64 rays of its row, since a small patch may
/// be missed from afar; until nothing new turns up. With `all`, every row is cast.
///
/// F_ij = hits_j / valid rays; Sobol-Owen points (see [`PointSets`](super::PointSets)), `rays` a patch, a power of two.
/// Rays that meet the back of a one-sided surface started hidden and are dropped; unless they started in the open,
/// beside the back of a sheet, which lets no light out.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
///
/// # Accuracy
/// The standard error of F_ij is at most sqrt(F (1 - F) / rays). Same seed, same bits, on any number of threads.
pub fn estimate(
    simplified: &Simplified,
    tracer: &dyn RayTracer,
    lit: &[bool],
    all: bool,
    rays: u32,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Estimate> {
    let points = RowPoints::new(rays, seed, tracer);
    let casting = Casting::new(simplified, tracer, &[], &points);
    let plan = Plan { start: lit, all, ..Plan::default() };
    let mut rows = Rows::new(simplified.patches.len());
    estimate_plan(&casting, &plan, &mut rows, &mut (), progress)
}

/// As [`estimate`], of the rows that `plan` asks for. Those that `rows` has are taken from there, the others are cast
/// and put there; which of them were known makes no difference to the result.
///
/// # Errors
/// Those of `keeper`, and [`Error::Interrupted`](crate::Error::Interrupted).
pub fn estimate_plan(
    casting: &Casting,
    plan: &Plan,
    rows: &mut Rows,
    keeper: &mut dyn RowKeeper,
    progress: &dyn Progress,
) -> Result<Estimate> {
    let n = casting.simplified.patches.len();
    let of = |marks: &[bool], i: u32| marks.get(i as usize).is_some_and(|&m| m);
    let caster = Caster::new(casting);
    let mut reached = plan.start.to_vec();
    let mut has_row = reached.clone();
    // Several threads set marks, which is the same in any order.
    let met: Vec<AtomicBool> = (0..n).map(|_| AtomicBool::new(false)).collect();
    let (mut views, mut few) = (vec![View::Within; n], vec![false; n]);
    let mut first = true;
    let (mut cast, mut clear) = (0, 0);
    let mut wave: Vec<u32> = (0..n as u32).filter(|&i| reached[i as usize]).collect();
    let mut pending: Vec<u32> = Vec::new();
    progress.begin("form factors", n as u64);
    loop {
        while !wave.is_empty() {
            // What reached patches see gets a row next.
            let sees = |i: u32| plan.backwards || reached[i as usize];
            for slice in caster.slices(&wave) {
                progress::go_on(progress, "form factors")?;
                cast += caster.add(slice, &few, Some(Seen { by: &sees, marks: &met }), rows, keeper)?;
                progress.advance(slice.len() as u64);
            }
            clear += wave.iter().filter(|i| caster.is_outer(**i)).count() as u64 * casting.points.rays() as u64;
            if plan.backwards && std::mem::take(&mut first) {
                few = little_seen(rows, &wave, &has_row, casting.points.rays());
            }
            if plan.backwards {
                wave.iter().for_each(|&i| reached[i as usize] = true);
            }
            pending.extend(wave.drain(..).filter(|&i| !reached[i as usize]));
            loop {
                let accepted = accept(&mut pending, rows, &reached, &met);
                accepted.iter().for_each(|&i| reached[i as usize] = true);
                accepted.par_chunks(64).with_max_len(1).for_each(|accepted| {
                    let entries = accepted.iter().filter_map(|&i| rows.get(i)).flat_map(|row| row.entries());
                    entries.for_each(|(j, _)| met[j as usize].store(true, Ordering::Relaxed));
                });
                if accepted.is_empty() {
                    break;
                }
            }
            for (i, met) in (0..).zip(&met) {
                let new = met.load(Ordering::Relaxed) && !std::mem::replace(&mut has_row[i as usize], true);
                if new && !of(plan.black, i) {
                    wave.push(i);
                }
            }
        }
        let unknown: Vec<u32> = (0..n as u32).filter(|&i| !has_row[i as usize]).collect();
        if plan.backwards {
            break;
        }
        if plan.all {
            // Whole rows look for light.
            has_row.fill(true);
            wave = unknown;
        } else {
            let outer = unknown.iter().filter(|&&i| caster.is_outer(i)).count() as u64;
            clear += outer * casting.points.probe_rays() as u64;
            for ((probe, rays), &i) in caster.probe(&unknown, &reached, rows).iter().zip(&unknown) {
                cast += rays;
                match probe {
                    Probe::SeesLight => wave.push(i),
                    Probe::Dark(view) => views[i as usize] = *view,
                }
            }
            wave.iter().for_each(|&i| has_row[i as usize] = true);
        }
        if wave.is_empty() {
            break;
        }
    }
    progress.end();
    for i in (0..n).filter(|&i| has_row[i]) {
        views[i] = rows.get(i as u32).map_or(views[i], |row| row.row.view);
    }
    // What no row met adds nothing to any of the wanted ones.
    let visible = |i: usize| views[i] != View::Hidden && (reached[i] || !plan.backwards);
    let visible = (0..n).map(visible).collect();
    let outside = (0..n).map(|i| !has_row[i] && views[i] == View::Outside).collect();
    let form_factors = FormFactors::of_rows(rows, if plan.all { &has_row } else { &reached }, &reached);
    Ok(Estimate { form_factors, reached, visible, outside, few, rays: cast, clear })
}

/// Casts the rows that [`estimate_plan`] casts first for a `plan` that goes backwards; which of the other rows it then
/// gives fewer rays.
///
/// # Errors
/// As of [`estimate_plan`].
pub fn first_wave(
    casting: &Casting,
    plan: &Plan,
    rows: &mut Rows,
    keeper: &mut dyn RowKeeper,
    progress: &dyn Progress,
) -> Result<Vec<bool>> {
    let wave: Vec<u32> = (0..plan.start.len() as u32).filter(|&i| plan.start[i as usize]).collect();
    cast(casting, &wave, &[], rows, keeper, progress)?;
    Ok(little_seen(rows, &wave, plan.start, casting.points.rays()))
}

/// Takes from `pending` the patches that see a reached one.
fn accept(pending: &mut Vec<u32>, rows: &Rows, reached: &[bool], met: &[AtomicBool]) -> Vec<u32> {
    let sees = |&i: &u32| {
        let entries = rows.get(i).into_iter().flat_map(|row| row.entries());
        let mut onto = entries.filter(|e| reached[e.0 as usize]);
        match (onto.next(), onto.next()) {
            (None, _) => false,
            (Some((_, 1)), None) => met[i as usize].load(Ordering::Relaxed),
            _ => true,
        }
    };
    let yes: Vec<bool> = pending.par_iter().with_min_len(64).map(sees).collect();
    let mut yes = yes.into_iter();
    let is_accepted = |_: &mut u32| yes.next().is_some_and(|yes| yes);
    pending.extract_if(.., is_accepted).collect()
}

/// Which patches none of the rows of `seeing` sees much of; those with a row already are not among them.
fn little_seen(rows: &Rows, seeing: &[u32], has_row: &[bool], rays: u32) -> Vec<bool> {
    let mut most = vec![0; rows.patches()];
    for (j, count) in seeing.iter().filter_map(|&i| rows.get(i)).flat_map(|row| row.entries()) {
        most[j as usize] = count.max(most[j as usize]);
    }
    most.iter().zip(has_row).map(|(&count, has_row)| !has_row && count * SEEN_LITTLE <= rays).collect()
}
