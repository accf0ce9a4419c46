//! What a bake of a case shows.

use glam::Vec3;
use luxel::bake::Bake;

use crate::{cases::Case, common::Stage};

/// Measurements of one bake, first channel unless said otherwise.
#[derive(Clone, Debug)]
pub struct Found {
    /// Largest share of power that the balance misses, of all channels: emitted = missed + absorbed + escaped; where a
    /// sky shines, direct = absorbed + escaped.
    pub lost: f64,
    /// What independent rays would make of the exchange between patches: standard error of the balance.
    pub sigma: f64,
    /// Error of the mean indirect irradiance, relative to the closed form; absolute where that is zero.
    pub mean: Option<f64>,
    /// Mean irradiance of the dark room's patches, and of its vertices, relative to the lit one's.
    pub leak: Option<[f64; 2]>,
    pub iterations: usize,
    /// Whether all light is finite and not negative.
    pub sound: bool,
}

impl Found {
    pub fn of(case: &Case, bake: &Bake) -> Found {
        let energy = &bake.report.energy;
        let balance = energy.unaccounted.unwrap_or(energy.imbalance);
        Found {
            lost: balance.into_iter().map(f64::abs).fold(0.0, f64::max),
            sigma: sigma(bake),
            mean: case.mean.map(|expected| {
                let mean = mean_indirect(bake);
                if expected > 0.0 { mean / expected - 1.0 } else { mean }
            }),
            leak: case.dark_beyond.map(|x| leak(&case.stage, bake, x)),
            iterations: bake.report.solver.iterations,
            sound: is_sound(bake),
        }
    }
}

/// Area of patch `i` that is not hidden, local; none of surfaces that no light reaches, such as the foot of a block.
fn seen_area(bake: &Bake, i: usize) -> f64 {
    let area = bake.patches().area[i] as f64 * (1.0 - bake.form_factors.hidden(i));
    if bake.light.reached[i] { area } else { 0.0 }
}

fn mean_indirect(bake: &Bake) -> f64 {
    let all = 0..bake.patches().len();
    let area: f64 = all.clone().map(|i| seen_area(bake, i)).sum();
    all.map(|i| seen_area(bake, i) * bake.light.indirect[i].x as f64).sum::<f64>() / area
}

/// The balance misses sum_i A_i B_i (1 - escape_i) - sum_i A_i (F B)_i: the estimated rows are not reciprocal. Each
/// row is a mean over its rays of the radiosity that they meet.
fn sigma(bake: &Bake) -> f64 {
    let (f, b) = (&bake.form_factors, &bake.light.radiosity);
    let mut variance = 0.0;
    for i in (0..bake.patches().len()).filter(|&i| f.has_row(i)) {
        let (mut mean, mut square) = (0.0, 0.0);
        for (j, share) in f.row(i) {
            let b = b[j].x as f64;
            mean += share * b;
            square += share * b * b;
        }
        let own = b[i].x as f64;
        let escape = f.escape(i);
        let of_ray = (square - mean * mean).max(0.0) + own * own * escape * (1.0 - escape);
        variance += seen_area(bake, i).powi(2) * of_ray / bake.report.settings.as_ref().map_or(1.0, |s| s.rays as f64);
    }
    let scale = bake.report.energy.direct[0];
    let frame = bake.report.counts.voxel_size / bake.simplified.grid.voxel_size;
    if scale > 0.0 { variance.sqrt() * frame * frame / scale } else { 0.0 }
}

fn leak(stage: &Stage, bake: &Bake, beyond: f64) -> [f64; 2] {
    let total = |direct: &[Vec3], indirect: &[Vec3], i: usize| (direct[i].x + indirect[i].x) as f64;
    let mean_of = |dark: bool, places: &[Vec3], of: &dyn Fn(usize) -> f64, weight: &dyn Fn(usize) -> f64| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (i, &p) in places.iter().enumerate() {
            if (stage.as_built(p).x > beyond) == dark {
                sum += weight(i) * of(i);
                weights += weight(i);
            }
        }
        sum / weights
    };
    let patches = |i: usize| total(&bake.light.direct, &bake.light.indirect, i);
    let vertices = |i: usize| total(&bake.vertices.direct, &bake.vertices.indirect, i);
    let areas = |i: usize| bake.patches().area[i] as f64;
    let places: Vec<Vec3> = bake.mesh.samples.iter().map(|s| s.position).collect();
    let centroids = &bake.patches().centroid;
    let lit = mean_of(false, centroids, &patches, &areas);
    [mean_of(true, centroids, &patches, &areas) / lit, mean_of(true, &places, &vertices, &|_| 1.0) / lit]
}

pub fn is_sound(bake: &Bake) -> bool {
    let light = [&bake.light.direct, &bake.light.indirect, &bake.light.radiosity];
    let vertices = [&bake.vertices.direct, &bake.vertices.indirect];
    let mut all = light.into_iter().chain(vertices).flatten();
    all.all(|e| e.is_finite() && e.min_element() >= 0.0)
}

/// Root mean square of the difference of indirect irradiance over the surface, relative to the mean; of its mean alone
/// where ties between surfaces gave other patches.
pub fn difference(a: &Bake, b: &Bake) -> f64 {
    let (mean, other) = (mean_indirect(a), mean_indirect(b));
    if mean == 0.0 {
        return other;
    }
    let (area, areas) = (&a.patches().area, &b.patches().area);
    let same = area.len() == areas.len() && area.iter().zip(areas).all(|(a, b)| (a - b).abs() <= 1e-6 * a);
    if !same {
        return (other / mean - 1.0).abs();
    }
    let off = |i: usize| (a.light.indirect[i].x as f64 - b.light.indirect[i].x as f64).powi(2);
    let square: f64 = (0..area.len()).map(|i| area[i] as f64 * off(i)).sum();
    (square / area.iter().map(|&a| a as f64).sum::<f64>()).sqrt() / mean
}
