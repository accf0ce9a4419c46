//! How far a bake is from the truth, told by the bake itself.
//!
//! Two errors add up. **Noise**: direct light is sampled by shadow rays, the light of a patch by the rays of its row.
//! Both are done again for some vertices and rows with other random bits; half the square of the difference is the
//! variance of one. **Discretisation**: patches have one radiosity each, and light between them is interpolated. The
//! same system is solved again on patches of twice the size, made by averaging its own rows, so that both solutions
//! have nearly the same noise; what they differ by at the vertices tells what the patches of the bake cost
//! (`coarse.rs`). Where points gather in doubt, others are held against gathers instead: what those tell more is what
//! interpolation costs.
//!
//! Both are taken at some of the vertices and then told of all by local means (`local.rs`).

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    Scene,
    bake::Bake,
    colour::luminance,
    light::LightSet,
    report::{ErrorParts, ErrorReport},
    sampling,
    scene::SurfacePoint,
    simplify::NO_PATCH,
    transfer::{RowPoints, Rows},
};

mod coarse;
mod local;
mod patches;
mod peak;
mod spread;

pub(crate) use patches::again;

use coarse::Coarse;
use local::Local;
use patches::Field;

/// Standard error of the luminance of irradiance at the vertices of a bake, W/m2.
#[derive(Clone, Debug, Default)]
pub struct VertexError {
    /// Of direct light.
    pub direct: Vec<f32>,
    /// Of indirect light.
    pub indirect: Vec<f32>,
    /// Of both together.
    pub total: Vec<f32>,
}

/// Share of the vertices that are looked at; and where vertices cast many rays of their own, as each then does three times.
const SHARE: f64 = 1.0 / 8.0;
const GATHERING_SHARE: f64 = 1.0 / 32.0;
/// Vertices that are looked at at least, where there are as many.
const LEAST: usize = 1024;
/// And at most, or so. The root of the mean of so many squares is known to 1/180 if they are normally distributed, and to 4 %
/// if their fourth moment is a hundred times the square of the second.
const MOST: f64 = 16384.0;
/// Purpose words of random bits.
const CHOICE: u64 = 0x0065_7374;
const AGAIN: u64 = 0x6167_6169;

/// Variances at the vertices that are looked at, (W/m2)2.
struct Variance {
    /// By shadow rays.
    shadow: Vec<f64>,
    /// By the rays of rows.
    rows: Vec<f64>,
    /// Square of the discretisation error; below zero where noise was larger than expected.
    detail: Vec<f64>,
}

/// Estimates the error of `bake`. Same bake, same bits, on any number of threads.
///
/// `again` holds rows of other rays; those that are not there are cast. Errors are those of luminance, relative to its mean; all means are over the area of the split mesh.
pub(crate) fn estimate(scene: &Scene, bake: &Bake, row_points: &RowPoints, again: &Rows) -> (ErrorReport, VertexError) {
    let share = if bake.options.reconstruct.gathers() { GATHERING_SHARE } else { SHARE };
    let vertices = bake.mesh.samples.len();
    let share = share.min(MOST / vertices as f64);
    let looked_at = chosen(vertices, share, LEAST, bake.options.seed ^ CHOICE);
    let points: Vec<SurfacePoint> = looked_at.iter().map(|&v| bake.mesh.samples[v as usize]).collect();
    // The first sample is there, where it stands alone.
    let first = bake.glow.is_none().then(|| looked_at.iter().map(|&v| bake.vertices.direct[v as usize]).collect());
    // Each has parts for one thread: they go beside each other, here and below.
    let (coarse, (mut direct, areas)) = rayon::join(
        || Coarse::new(scene, bake),
        || (Variance::of_shadow_rays(bake, &bake.lights, &points, first), vertex_areas(bake)),
    );
    if let Some(glow) = &bake.glow {
        let field = Field { received: glow, sent: &bake.patches().emitted, reflects: false };
        direct.add(&patches::variance(bake, &coarse, &field, &points, row_points, again));
    }
    let field = Field { received: &bake.smooth, sent: &bake.carried, reflects: true };
    let mut indirect = patches::variance(bake, &coarse, &field, &points, row_points, again);
    if let Some(bright) = &bake.bright {
        indirect.add(&Variance::of_shadow_rays(bake, bright, &points, None));
    }

    let light = &bake.vertices;
    let sum: Vec<Vec3> = light.direct.iter().zip(&light.indirect).map(|(a, b)| *a + *b).collect();
    let places = Places { bake, areas, looked_at };
    let (of_direct, of_indirect) =
        rayon::join(|| places.spread(&direct, &light.direct), || places.spread(&indirect, &light.indirect));
    let total: Vec<f32> = of_direct.iter().zip(&of_indirect).map(|(a, b)| a.hypot(*b)).collect();
    let (direct_parts, indirect_parts) = rayon::join(
        || places.parts(&direct, &light.direct, &of_direct),
        || places.parts(&indirect, &light.indirect, &of_indirect),
    );
    direct.add(&indirect);
    let looked_at: Vec<f64> = places.looked_at.iter().map(|&v| places.areas[v as usize]).collect();
    let peak = peak::find(&direct, &points, &looked_at, &scene.frame);
    let report = ErrorReport {
        direct: direct_parts,
        indirect: indirect_parts,
        total: places.parts(&direct, &sum, &total),
        vertices: points.len(),
        peak,
    };
    (report, VertexError { direct: of_direct, indirect: of_indirect, total })
}

impl Variance {
    /// Half the square of the difference of two samples of the light of `lights`: the `first` is that of the bake.
    fn of_shadow_rays(bake: &Bake, lights: &LightSet, points: &[SurfacePoint], first: Option<Vec<Vec3>>) -> Variance {
        let light = |seed: u64| bake.sampled(lights, points, bake.options.point_samples, seed).irradiance;
        let first = first.unwrap_or_else(|| light(bake.options.seed));
        let second = light(bake.options.seed ^ AGAIN);
        let shadow = first.iter().zip(&second).map(|(a, b)| 0.5 * luminance(*a - *b).powi(2)).collect();
        Variance { shadow, rows: vec![0.0; points.len()], detail: vec![0.0; points.len()] }
    }

    fn add(&mut self, other: &Variance) {
        let add = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        add(&mut self.shadow, &other.shadow);
        add(&mut self.rows, &other.rows);
        add(&mut self.detail, &other.detail);
    }
}

/// The vertices of a bake, and which of them were looked at.
struct Places<'a> {
    bake: &'a Bake,
    /// Of all vertices.
    areas: Vec<f64>,
    looked_at: Vec<u32>,
}

impl Places<'_> {
    /// Standard errors of `light` at all vertices.
    fn spread(&self, variance: &Variance, light: &[Vec3]) -> Vec<f32> {
        let samples = &self.bake.mesh.samples;
        let mut local = Local::new(self.bake.simplified.grid, self.mean(light));
        for (k, &v) in self.looked_at.iter().enumerate() {
            let (v, all) = (v as usize, variance.shadow[k] + variance.rows[k] + variance.detail[k]);
            local.add(&samples[v], self.areas[v], all, luminance(light[v]));
        }
        let sigma = |(p, e): (&SurfacePoint, &Vec3)| local.variance(p, luminance(*e)).max(0.0).sqrt() as f32;
        samples.par_iter().zip(light).map(sigma).collect()
    }

    /// What the variance of `light` comes to; `sigma` is its standard error at all vertices.
    fn parts(&self, variance: &Variance, light: &[Vec3], sigma: &[f32]) -> ErrorParts {
        let mean = self.mean(light);
        if mean <= 0.0 {
            return ErrorParts::default();
        }
        let area = |v: u32| self.areas[v as usize];
        let all: f64 = self.looked_at.iter().map(|&v| area(v)).sum();
        let relative = |squares: &[f64]| {
            let sum: f64 = self.looked_at.iter().zip(squares).map(|(&v, s)| area(v) * s).sum();
            (sum / all.max(f64::MIN_POSITIVE)).max(0.0).sqrt() / mean
        };
        let (shadow_noise, row_noise, discretisation) =
            (relative(&variance.shadow), relative(&variance.rows), relative(&variance.detail));
        let noise = shadow_noise.hypot(row_noise);
        ErrorParts {
            shadow_noise,
            row_noise,
            noise,
            discretisation,
            total: noise.hypot(discretisation),
            p95: spread::percentile_95(sigma, &self.areas) / mean,
        }
    }

    /// Mean luminance.
    fn mean(&self, light: &[Vec3]) -> f64 {
        let sum: f64 = self.areas.iter().zip(light).map(|(a, e)| a * luminance(*e)).sum();
        sum / self.areas.iter().sum::<f64>().max(f64::MIN_POSITIVE)
    }
}

/// A share of 0 .. n, chosen by hash; at least `least` of them or so.
fn chosen(n: usize, share: f64, least: usize, seed: u64) -> Vec<u32> {
    let share = share.max(least as f64 / n.max(1) as f64).min(1.0);
    let limit = (share * u64::MAX as f64) as u64;
    (0..n as u32).filter(|&i| sampling::hash(&[seed, i as u64]) <= limit).collect()
}

/// A third of the triangles around each vertex, without those that lie hidden inside of objects; local units squared.
fn vertex_areas(bake: &Bake) -> Vec<f64> {
    let mut areas = vec![0.0; bake.mesh.positions.len()];
    let hidden = |patch: u32| patch != NO_PATCH && !bake.light.known[patch as usize];
    let visible = bake.mesh.triangles.iter().zip(&bake.mesh.patch).filter(|(_, patch)| !hidden(**patch));
    for (triangle, _) in visible {
        let [a, b, c] = triangle.map(|v| bake.mesh.positions[v as usize].as_dvec3());
        let area = 0.5 * (b - a).cross(c - a).length();
        triangle.iter().for_each(|&v| areas[v as usize] += area / 3.0);
    }
    areas
}
