//! How far a bake is from the truth, told by the bake itself.
//!
//! Two errors add up. **Noise**: direct light is sampled by shadow rays, the light of a patch by the rays of its row.
//! Both are done again for some vertices and rows with other random bits; half the square of the difference is the
//! variance of one. **Discretisation**: patches have one radiosity each, and light between them is interpolated. The
//! same system is solved again on patches of twice the size, made by averaging its own rows, so that both solutions
//! have nearly the same noise; what they differ by at the vertices tells what the patches of the bake cost
//! ([`coarse`]).
//!
//! Both are taken at some of the vertices ([`chosen`]) and then told of all by local means ([`Local`]).

use glam::Vec3;

use crate::{
    Scene,
    bake::Bake,
    light::{self, LightSet},
    output::tonemap::luminance,
    report::{ErrorParts, ErrorReport},
    sampling,
    scene::SurfacePoint,
};

mod coarse;
mod local;
mod patches;
mod spread;

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

/// Share of the vertices that are looked at.
const SHARE: f64 = 1.0 / 8.0;
/// Vertices that are looked at at least, where there are as many.
const LEAST: usize = 1024;
/// Purpose words of random bits.
const CHOICE: u64 = 0x0065_7374;
const AGAIN: u64 = 0x6167_6169;

/// Variances at the vertices that are looked at, (W/m2)2.
struct Variance {
    noise: Vec<f64>,
    /// Square of the discretisation error; below zero where noise was larger than expected.
    detail: Vec<f64>,
}

/// Estimates the error of `bake`. Same bake, same bits, on any number of threads.
///
/// Errors are those of luminance, relative to its mean; all means are over the area of the split mesh.
pub fn estimate(scene: &Scene, bake: &Bake) -> (ErrorReport, VertexError) {
    let areas = vertex_areas(bake);
    let looked_at = chosen(bake.mesh.samples.len(), SHARE, LEAST, bake.options.seed ^ CHOICE);
    let points: Vec<SurfacePoint> = looked_at.iter().map(|&v| bake.mesh.samples[v as usize]).collect();

    let mut direct = Variance { noise: sampled(bake, &bake.lights, &points), detail: vec![0.0; points.len()] };
    let coarse = coarse::Coarse::new(scene, bake);
    if let Some(glow) = &bake.glow {
        let emitted = &bake.patches().emitted;
        direct.add(patches::variance(
            bake,
            &coarse,
            &Field { received: glow, sent: emitted, reflects: false },
            &points,
        ));
    }
    let field = Field { received: &bake.smooth, sent: &bake.carried, reflects: true };
    let mut indirect = patches::variance(bake, &coarse, &field, &points);
    if let Some(bright) = &bake.bright {
        indirect.noise.iter_mut().zip(sampled(bake, bright, &points)).for_each(|(a, b)| *a += b);
    }

    let light = &bake.vertices;
    let total_light: Vec<Vec3> = light.direct.iter().zip(&light.indirect).map(|(a, b)| *a + *b).collect();
    let own = |v: &[Vec3]| looked_at.iter().map(|&i| luminance(v[i as usize]) as f64).collect::<Vec<f64>>();
    let weights: Vec<f64> = looked_at.iter().map(|&v| areas[v as usize]).collect();
    let spread = |variance: &Variance, all: &[Vec3]| {
        let mean = area_mean(&areas, all);
        let mut local = Local::new(bake.simplified.grid, mean);
        for (k, e) in own(all).into_iter().enumerate() {
            local.add(&points[k], weights[k], variance.noise[k] + variance.detail[k], e);
        }
        let sigma: Vec<f32> = bake
            .mesh
            .samples
            .iter()
            .zip(all)
            .map(|(p, e)| local.variance(p, luminance(*e) as f64).max(0.0).sqrt() as f32)
            .collect();
        (sigma, mean)
    };
    let (direct_error, direct_mean) = spread(&direct, &light.direct);
    let (indirect_error, indirect_mean) = spread(&indirect, &light.indirect);
    let total_error: Vec<f32> = direct_error.iter().zip(&indirect_error).map(|(a, b)| a.hypot(*b)).collect();

    let parts = |variance: &Variance, mean: f64, sigma: &[f32]| {
        let noise = relative(area_mean_of(&weights, &variance.noise), mean);
        let detail = relative(area_mean_of(&weights, &variance.detail), mean);
        let p95 = if mean > 0.0 { spread::percentile_95(sigma, &areas) / mean } else { 0.0 };
        ErrorParts { noise, discretisation: detail, total: noise.hypot(detail), p95 }
    };
    let direct_parts = parts(&direct, direct_mean, &direct_error);
    let indirect_parts = parts(&indirect, indirect_mean, &indirect_error);
    direct.add(indirect);
    let total_parts = parts(&direct, area_mean(&areas, &total_light), &total_error);
    let report =
        ErrorReport { direct: direct_parts, indirect: indirect_parts, total: total_parts, vertices: points.len() };
    (report, VertexError { direct: direct_error, indirect: indirect_error, total: total_error })
}

impl Variance {
    fn add(&mut self, other: Variance) {
        self.noise.iter_mut().zip(other.noise).for_each(|(a, b)| *a += b);
        self.detail.iter_mut().zip(other.detail).for_each(|(a, b)| *a += b);
    }
}

/// Variance of the irradiance that shadow rays find at `points`: half the square of the difference of two.
fn sampled(bake: &Bake, lights: &LightSet, points: &[SurfacePoint]) -> Vec<f64> {
    let samples = bake.options.point_samples;
    let light = |seed: u64| light::irradiance(lights, bake.tracer(), points, 1, samples, seed).irradiance;
    let (first, second) = (light(bake.options.seed), light(bake.options.seed ^ AGAIN));
    first.iter().zip(&second).map(|(a, b)| 0.5 * (luminance(*a - *b) as f64).powi(2)).collect()
}

/// A share of 0 .. n, chosen by hash; at least `least` of them or so.
fn chosen(n: usize, share: f64, least: usize, seed: u64) -> Vec<u32> {
    let share = share.max(least as f64 / n.max(1) as f64).min(1.0);
    let limit = (share * u64::MAX as f64) as u64;
    (0..n as u32).filter(|&i| sampling::hash(&[seed, i as u64]) <= limit).collect()
}

/// A third of the triangles around each vertex; local units squared.
fn vertex_areas(bake: &Bake) -> Vec<f64> {
    let mut areas = vec![0.0; bake.mesh.positions.len()];
    for triangle in &bake.mesh.triangles {
        let [a, b, c] = triangle.map(|v| bake.mesh.positions[v as usize].as_dvec3());
        let area = 0.5 * (b - a).cross(c - a).length();
        triangle.iter().for_each(|&v| areas[v as usize] += area / 3.0);
    }
    areas
}

fn area_mean(areas: &[f64], values: &[Vec3]) -> f64 {
    let sum: f64 = areas.iter().zip(values).map(|(a, v)| a * luminance(*v) as f64).sum();
    sum / areas.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

fn area_mean_of(areas: &[f64], values: &[f64]) -> f64 {
    let sum: f64 = areas.iter().zip(values).map(|(a, v)| a * v).sum();
    sum / areas.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

/// Root of a mean square, as a share of `mean`.
fn relative(mean_square: f64, mean: f64) -> f64 {
    if mean > 0.0 { mean_square.max(0.0).sqrt() / mean } else { 0.0 }
}
