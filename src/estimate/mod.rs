//! How far a bake is from the truth, told by the bake itself.
//!
//! Two errors add up. **Noise**: direct light is sampled by shadow rays, the light of a patch by the rays of its row.
//! Both are done again for some vertices and rows with other random bits; half the square of the difference is the
//! variance of one. **Discretisation**: patches have one radiosity each, and light between them is interpolated. The
//! same system is solved again on patches of twice the size, made by averaging its own rows, so that both solutions
//! have nearly the same noise; what they differ by at the vertices tells what the patches of the bake cost
//! (`coarse.rs`). Neither level knows of what is smaller than its voxels, a groove or the crack under a door. So where
//! interpolation is in doubt vertices are held against rays of their own (`gathers.rs`), and everywhere if vertices in
//! doubt gather anyway.
//!
//! Both are taken at some of the vertices and then told of all by local means (`local.rs`).

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    Result, Scene,
    bake::{Bake, Kept},
    colour::luminance,
    light::LightSet,
    progress::Progress,
    reconstruct::{self, Stencils},
    report::{ErrorParts, ErrorReport},
    sampling,
    scene::SurfacePoint,
    simplify::NO_PATCH,
    transfer::RowPoints,
};

mod coarse;
mod gathers;
mod local;
mod patches;
mod peak;
mod replicates;
mod spread;

pub(crate) use replicates::{replicate, replicated};

use coarse::Coarse;
use local::Local;
use patches::Field;
use replicates::Replicates;

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

/// Share of the vertices that are looked at; and where vertices cast many rays of their own, as each then does twice more.
const SHARE: f64 = 1.0 / 8.0;
const GATHERING_SHARE: f64 = 1.0 / 32.0;
/// Vertices that are looked at at least, where there are as many.
const LEAST: usize = 512;
/// And at most, or so. The root of the mean of so many squares is known to 1/180 if they are normally distributed, and to 4 %
/// if their fourth moment is a hundred times the square of the second.
const MOST: f64 = 16384.0;
/// Vertices in doubt that are looked at at most, or so, in bakes that interpolate there: gathers are most of the work.
const MOST_IN_DOUBT: f64 = 512.0;
/// Purpose words of random bits.
const CHOICE: u64 = 0x0065_7374;
const FEWER: u64 = 0x6665_7765;
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
/// Errors are those of luminance, relative to its mean; all means are over the area of the split mesh. `row_points` are those of
/// the rows, whose replicates go to `kept` and are taken from there.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted), while replicates are cast.
pub(crate) fn estimate(
    scene: &Scene,
    bake: &Bake,
    row_points: &RowPoints,
    kept: &mut Kept,
    progress: &dyn Progress,
) -> Result<(ErrorReport, VertexError)> {
    let replicates = Replicates::new(bake, row_points, kept, progress)?;
    let looked_at = LookedAt::choose(bake);
    let points = &looked_at.points;
    // The first sample is there, where it stands alone.
    let first =
        bake.glow.is_none().then(|| looked_at.vertices.iter().map(|&v| bake.vertices.direct[v as usize]).collect());
    // Each has parts for one thread: they go beside each other, here and below.
    let (coarse, (mut direct, areas)) = rayon::join(
        || Coarse::new(scene, bake),
        || (Variance::of_shadow_rays(bake, &bake.lights, points, first), vertex_areas(bake)),
    );
    if let Some(glow) = &bake.glow {
        let field = Field { received: glow, sent: &bake.patches().emitted, reflects: false };
        direct.add(&patches::variance(bake, &coarse, &field, &looked_at, &replicates));
    }
    let field = Field { received: &bake.smooth, sent: &bake.carried, reflects: true };
    let mut indirect = patches::variance(bake, &coarse, &field, &looked_at, &replicates);
    if let Some(bright) = &bake.bright {
        indirect.add(&Variance::of_shadow_rays(bake, bright, points, None));
    }

    let light = &bake.vertices;
    let sum: Vec<Vec3> = light.direct.iter().zip(&light.indirect).map(|(a, b)| *a + *b).collect();
    let places = Places { bake, areas, looked_at: &looked_at };
    let (of_direct, of_indirect) =
        rayon::join(|| places.spread(&direct, &light.direct), || places.spread(&indirect, &light.indirect));
    let total: Vec<f32> = of_direct.iter().zip(&of_indirect).map(|(a, b)| a.hypot(*b)).collect();
    let (direct_parts, indirect_parts) = rayon::join(
        || places.parts(&direct, &light.direct, &of_direct),
        || places.parts(&indirect, &light.indirect, &of_indirect),
    );
    direct.add(&indirect);
    let peak = peak::find(&direct, points, &places.areas_looked_at(), &scene.frame);
    let report = ErrorReport {
        direct: direct_parts,
        indirect: indirect_parts,
        total: places.parts(&direct, &sum, &total),
        vertices: points.len(),
        peak,
    };
    Ok((report, VertexError { direct: of_direct, indirect: of_indirect, total }))
}

/// Vertices whose errors are measured, and told of all.
struct LookedAt {
    vertices: Vec<u32>,
    points: Vec<SurfacePoint>,
    /// Where interpolation is in doubt.
    doubt: Vec<bool>,
    /// How many vertices of its kind each stands for.
    weight: Vec<f64>,
    /// Which patches the points see.
    stencils: Stencils,
}

impl LookedAt {
    /// Some of all vertices; fewer of those in doubt where that spares gathers.
    fn choose(bake: &Bake) -> LookedAt {
        let (seed, gathers) = (bake.options.seed, bake.options.reconstruct.gathers());
        let count = bake.mesh.samples.len();
        let share = if gathers { GATHERING_SHARE } else { SHARE };
        let all = chosen(count, share.min(MOST / count as f64), LEAST, seed ^ CHOICE);
        let points = |of: &[u32]| of.iter().map(|&v| bake.mesh.samples[v as usize]).collect::<Vec<SurfacePoint>>();
        let field = bake.field(&bake.smooth, &bake.carried);
        let places = points(&all);
        let stencils = Stencils::new(&field, &places);
        let doubt = reconstruct::in_doubt(&reconstruct::Field { stencils: Some(&stencils), ..field }, &places);

        let in_doubt = doubt.iter().filter(|&&d| d).count();
        let share = if gathers { 1.0 } else { (MOST_IN_DOUBT / in_doubt as f64).min(1.0) };
        let stays = |v: u32, doubt: bool| !doubt || is_chosen(v, share, seed ^ FEWER);
        let (vertices, doubt): (Vec<u32>, Vec<bool>) = all.into_iter().zip(doubt).filter(|&(v, d)| stays(v, d)).unzip();
        let each = in_doubt as f64 / doubt.iter().filter(|&&d| d).count() as f64;
        let weight = doubt.iter().map(|&d| if d { each } else { 1.0 }).collect();
        LookedAt { points: points(&vertices), vertices, doubt, weight, stencils }
    }
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
    looked_at: &'a LookedAt,
}

impl Places<'_> {
    /// Standard errors of `light` at all vertices.
    fn spread(&self, variance: &Variance, light: &[Vec3]) -> Vec<f32> {
        let samples = &self.bake.mesh.samples;
        let mut local = Local::new(self.bake.simplified.grid, self.mean(light));
        for (k, &v) in self.looked_at.vertices.iter().enumerate() {
            let (v, all) = (v as usize, variance.shadow[k] + variance.rows[k] + variance.detail[k]);
            local.add(&samples[v], self.looked_at.weight[k] * self.areas[v], all, luminance(light[v]));
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
        let areas = self.areas_looked_at();
        let all: f64 = areas.iter().sum();
        let relative = |squares: &[f64]| {
            let sum: f64 = areas.iter().zip(squares).map(|(area, s)| area * s).sum();
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

    /// What each vertex that is looked at stands for.
    fn areas_looked_at(&self) -> Vec<f64> {
        let LookedAt { vertices, weight, .. } = self.looked_at;
        vertices.iter().zip(weight).map(|(&v, w)| w * self.areas[v as usize]).collect()
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
    (0..n as u32).filter(|&i| is_chosen(i, share, seed)).collect()
}

fn is_chosen(i: u32, share: f64, seed: u64) -> bool {
    sampling::hash(&[seed, i as u64]) <= (share * u64::MAX as f64) as u64
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
