//! The program: one line a stage, in the order of the paper's algorithm.

use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    BakeOptions, Error, Result, Scene, forecast,
    light::{self, Bright, LightSet},
    options::{PatchSource, Primary},
    progress::Progress,
    reconstruct::{self, Field, PatchIndex},
    report::{Counts, Energy, Rays, Report, RowSums, Skipped, Solver, Stage},
    simplify::{self, Grid, NO_PATCH, Patches, Simplified, SplitMesh},
    solve,
    trace::{self, Hit, RayTracer},
    transfer::{self, FormFactors},
};

/// A point of a surface that receives light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position, local.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
}

/// Irradiance, W/m2, one entry a point.
#[derive(Clone, Debug, Default)]
pub struct Irradiance {
    /// Straight from lights.
    pub direct: Vec<Vec3>,
    /// After at least one reflection.
    pub indirect: Vec<Vec3>,
}

/// Light of the patches.
#[derive(Clone, Debug, Default)]
pub struct PatchLight {
    /// Direct irradiance, W/m2.
    pub direct: Vec<Vec3>,
    /// Indirect irradiance, W/m2.
    pub indirect: Vec<Vec3>,
    /// Reflected radiosity, W/m2; emission is not in it.
    pub radiosity: Vec<Vec3>,
    /// Whether light reaches the patch at all.
    pub reached: Vec<bool>,
    /// Whether the patch has a value: not if all of it lies hidden inside or behind objects.
    pub known: Vec<bool>,
}

/// A finished bake.
pub struct Bake {
    /// The surfaces cut by the voxels.
    pub mesh: SplitMesh,
    /// Light at the vertices of `mesh`.
    pub vertices: Irradiance,
    /// The patches and the surfaces that they stand for.
    pub simplified: Simplified,
    /// Form factors between the patches.
    pub form_factors: FormFactors,
    /// Light of the patches.
    pub light: PatchLight,
    /// What was measured.
    pub report: Report,
    options: BakeOptions,
    lights: LightSet,
    /// Bright patches, whose first reflection lights vertices and points as lamps do.
    bright: Option<LightSet>,
    /// Irradiance of the patches straight from emitting patches; `None` where emitters are sampled as lights.
    glow: Option<Vec<Vec3>>,
    /// Indirect irradiance of the patches without what the bright ones send.
    smooth: Vec<Vec3>,
    index: PatchIndex,
    /// Normals of the scene's triangles.
    normals: Vec<Vec3>,
    tracer: Box<dyn RayTracer>,
    /// Tracer of the voxel faces, where they are the patches.
    face_tracer: Option<Box<dyn RayTracer>>,
}

impl SurfacePoint {
    /// Whether the position is finite and the normal a unit vector.
    pub(crate) fn is_sound(&self) -> bool {
        self.position.is_finite() && (self.normal.length_squared() - 1.0).abs() < 0.01
    }
}

impl Bake {
    /// The patches.
    pub fn patches(&self) -> &Patches {
        &self.simplified.patches
    }

    /// The tracer of the scene's surfaces.
    pub fn tracer(&self) -> &dyn RayTracer {
        &*self.tracer
    }

    /// The tracer that [`Bake::patch_of`] understands: that of the surfaces, or of the voxel faces.
    pub fn patch_tracer(&self) -> &dyn RayTracer {
        self.face_tracer.as_deref().unwrap_or(&*self.tracer)
    }

    /// The patch that a ray of [`Bake::patch_tracer`] met; `None` if nothing or the inside of an object.
    pub fn patch_of(&self, hit: &Hit) -> Option<u32> {
        if !hit.is_hit() {
            return None;
        }
        let patch = self.simplified.hit_map.patch(&self.simplified.fragments, hit);
        (patch != NO_PATCH).then_some(patch)
    }

    /// Radiance of the sky in a direction that meets no surface, W/m2/sr.
    pub fn sky_radiance(&self, direction: Vec3) -> Vec3 {
        self.lights.sky_radiance(direction)
    }

    /// Irradiance at surface points of the scene. The light of a point depends on nothing but the point itself; it is
    /// zero where the point is not finite or its normal is not a unit vector. Points in the edges of the mesh are lit
    /// from slightly inside of the room.
    pub fn irradiance(&self, points: &[SurfacePoint], progress: &dyn Progress) -> Irradiance {
        self.irradiance_with(points, self.options.point_samples, progress)
    }

    /// As [`Bake::irradiance`], with another number of shadow rays a point.
    pub fn irradiance_with(&self, points: &[SurfacePoint], samples: u32, progress: &dyn Progress) -> Irradiance {
        let points = reconstruct::clear_of_walls(&*self.tracer, &self.normals, points);
        self.light(&points, samples, progress)
    }

    /// Light at points that stand clear of walls.
    fn light(&self, points: &[SurfacePoint], samples: u32, progress: &dyn Progress) -> Irradiance {
        progress.begin("points", points.len() as u64);
        let mut all = Irradiance::default();
        for block in points.chunks(BLOCK) {
            let lit = |lights: &LightSet| {
                light::irradiance(lights, &*self.tracer, block, 1, samples, self.options.seed).irradiance
            };
            all.direct.extend(add(lit(&self.lights), self.glow.as_ref().map(|glow| self.interpolate(block, glow))));
            all.indirect.extend(add(self.interpolate(block, &self.smooth), self.bright.as_ref().map(lit)));
            progress.advance(block.len() as u64);
        }
        progress.end();
        all
    }

    fn interpolate(&self, points: &[SurfacePoint], values: &[Vec3]) -> Vec<Vec3> {
        let field = Field {
            simplified: &self.simplified,
            index: &self.index,
            values,
            known: &self.light.known,
            tracer: &*self.tracer,
            normals: &self.normals,
            cos_threshold: self.options.normal_threshold.to_radians().cos(),
        };
        reconstruct::interpolate(&field, self.options.reconstruct, points)
    }
}

/// Sums, where there is something to add.
fn add(mut a: Vec<Vec3>, b: Option<Vec<Vec3>>) -> Vec<Vec3> {
    a.iter_mut().zip(b.into_iter().flatten()).for_each(|(a, b)| *a += b);
    a
}

/// Points that are lit at once.
const BLOCK: usize = 1 << 14;
/// Points on patches that are made at once, to bound their memory.
const PATCH_POINTS: usize = 1 << 19;

/// Bakes a scene.
///
/// # Errors
/// [`Error::Scene`] without geometry or light, [`Error::Backend`] for a tracer that is not there, [`Error::Option`]
/// for options without sense or voxels too small for the memory.
pub fn bake(scene: &Scene, options: &BakeOptions, progress: &dyn Progress) -> Result<Bake> {
    check(scene, options)?;
    let mut clock = Clock::new();

    let grid = Grid::new(scene, options.resolution)?;
    simplify::check_size(scene, &grid, forecast::FRAGMENT_BYTES)?;
    let tracer = trace::build(options.backend, &scene.geometry())?;
    let lights = LightSet::new(scene);
    clock.stop("build");

    let (simplified, face_tracer) = match options.patches {
        PatchSource::Surfels => (simplify::surfels(scene, grid, &*tracer), None),
        PatchSource::Faces => {
            let simplified = simplify::faces(scene, grid, options.face_colour);
            let face_tracer = trace::build(options.backend, &simplified.geometry)?;
            (simplified, Some(face_tracer))
        }
    };
    simplify::check_rows(simplified.patches.len(), options.rays, forecast::RAY_BYTES)?;
    clock.stop("simplify");

    let lights = if options.primary == Primary::Radiosity { lights.without_surfaces() } else { lights };
    let (mut direct, mut visibility) = patch_direct(&simplified, &lights, &*tracer, options, progress);
    clock.stop("direct");

    let patches = &simplified.patches;
    let glows = |i: usize| options.primary == Primary::Radiosity && patches.emitted[i] != Vec3::ZERO;
    let lit: Vec<bool> = (0..patches.len()).map(|i| direct[i] != Vec3::ZERO || glows(i)).collect();
    if !lit.contains(&true) {
        return Err(Error::Scene(format!(
            "scene \"{}\": no light reaches any surface; do the lights lie inside objects, or do lamps and walls turn \
             their backs to each other? (try --sides two, or `luxel check`)",
            scene.name
        )));
    }
    let rows_tracer = face_tracer.as_deref().unwrap_or(&*tracer);
    let estimate = transfer::estimate(
        &simplified,
        rows_tracer,
        &lit,
        !options.skip_unreached,
        options.rays,
        options.seed,
        progress,
    );
    let rows_seconds = clock.stop("form factors");
    let form_factors = estimate.form_factors;

    // Hidden parts of a patch were counted as dark. What slips through cracks onto a patch that is hidden altogether
    // is no light.
    for (i, e) in direct.iter_mut().enumerate() {
        let seen = 1.0 - form_factors.hidden(i) as f32;
        *e = if seen > 0.0 { (*e / seen.max(0.05)).min(Vec3::MAX) } else { Vec3::ZERO };
    }
    let glow = (options.primary == Primary::Radiosity).then(|| {
        let emitted: Vec<[f64; 3]> = patches.emitted.iter().map(|&m| rgb(m)).collect();
        let mut received = vec![[0.0; 3]; patches.len()];
        form_factors.multiply(&emitted, &mut received);
        received.into_iter().map(vec3).collect::<Vec<Vec3>>()
    });
    direct = add(direct, glow.clone());
    let albedo: Vec<[f64; 3]> = patches.albedo.iter().map(|&a| rgb(a)).collect();
    let source: Vec<[f64; 3]> =
        direct.iter().zip(&albedo).map(|(e, a)| std::array::from_fn(|c| e[c] as f64 * a[c])).collect();
    // The first reflection of bright patches is sent by shadow rays, the rest by form factors.
    let bright = match options.patches {
        PatchSource::Surfels => Bright::choose(&simplified, &source, &estimate.reached),
        PatchSource::Faces => None,
    };
    let mut sent = vec![Vec3::ZERO; patches.len()];
    let mut rest = source.clone();
    if let Some(bright) = &bright {
        let (received, rays) = patch_direct(&simplified, &bright.lights, &*tracer, options, progress);
        visibility += rays;
        bright.patches.iter().for_each(|&i| rest[i as usize] = [0.0; 3]);
        for i in 0..patches.len() {
            if form_factors.has_row(i) {
                sent[i] = received[i] / (1.0 - form_factors.hidden(i) as f32).max(0.05);
                rest[i] = std::array::from_fn(|c| rest[i][c] + albedo[i][c] * sent[i][c] as f64);
            }
        }
        clock.stop("bright patches");
    }
    let solution = solve::solve(&form_factors, &albedo, &rest, options.tolerance);
    clock.stop("solve");

    let smooth: Vec<Vec3> = solution.irradiance.iter().map(|&e| vec3(e)).collect();
    let indirect: Vec<Vec3> = smooth.iter().zip(&sent).map(|(a, b)| *a + *b).collect();
    let mut radiosity: Vec<Vec3> = solution.radiosity.iter().map(|&b| vec3(b)).collect();
    if let Some(bright) = &bright {
        bright.patches.iter().for_each(|&i| radiosity[i as usize] += vec3(source[i as usize]));
    }
    let light = PatchLight { direct, indirect, radiosity, reached: estimate.reached, known: estimate.visible };
    let index = PatchIndex::new(&simplified.patches, grid);
    let mesh = vertex_mesh(scene, &simplified, &light, &index, options, &*tracer);
    clock.stop("split mesh");

    let normals = (0..scene.triangles.len()).into_par_iter().map(|t| scene.normal(t)).collect();
    let mut bake = Bake {
        mesh,
        vertices: Irradiance::default(),
        simplified,
        form_factors,
        light,
        report: Report::default(),
        options: options.clone(),
        lights,
        bright: bright.map(|b| b.lights),
        glow,
        smooth,
        index,
        normals,
        tracer,
        face_tracer,
    };
    bake.vertices = bake.light(&bake.mesh.samples, options.point_samples, progress);
    clock.stop("vertices");

    bake.report = report(scene, &bake, &solution, estimate.rays, visibility, rows_seconds, clock);
    Ok(bake)
}

fn check(scene: &Scene, options: &BakeOptions) -> Result<()> {
    let wrong = |message: String| Err(Error::Option(message));
    if scene.triangles.is_empty() {
        return Err(Error::Scene(format!("scene \"{}\" has no geometry", scene.name)));
    }
    if !(options.rays.is_power_of_two() && (16..=65536).contains(&options.rays)) {
        return wrong(format!("{} rays: it must be a power of two from 16 to 65536", options.rays));
    }
    if !(1..=65536).contains(&options.point_samples) || !(1..=65536).contains(&options.patch_samples) {
        return wrong("shadow samples must be from 1 to 65536".into());
    }
    if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
        return wrong(format!("tolerance {} is not between 0 and 1", options.tolerance));
    }
    if !(options.normal_threshold > 0.0 && options.normal_threshold < 90.0) {
        return wrong(format!("normal threshold {} is not between 0 and 90 degrees", options.normal_threshold));
    }
    if !scene.has_light() {
        return Err(Error::Scene(scene.no_light_message()));
    }
    Ok(())
}

/// Direct irradiance of the patches, and the rays it took.
fn patch_direct(
    simplified: &Simplified,
    lights: &LightSet,
    tracer: &dyn RayTracer,
    options: &BakeOptions,
    progress: &dyn Progress,
) -> (Vec<Vec3>, u64) {
    let all: Vec<u32> = (0..simplified.patches.len() as u32).collect();
    let samples = options.patch_samples;
    let (mut direct, mut rays) = (Vec::with_capacity(all.len()), 0);
    progress.begin("direct light", all.len() as u64);
    for block in all.chunks((PATCH_POINTS / samples as usize).max(1)) {
        let points = transfer::patch_points(simplified, block, samples, options.seed);
        let result = light::irradiance(lights, tracer, &points, samples as usize, samples, options.seed);
        direct.extend(result.irradiance);
        rays += result.rays;
        progress.advance(block.len() as u64);
    }
    progress.end();
    (direct, rays)
}

/// The mesh that light is told at: sides that light reaches, and the fronts of the rest.
fn vertex_mesh(
    scene: &Scene,
    simplified: &Simplified,
    light: &PatchLight,
    index: &PatchIndex,
    options: &BakeOptions,
    tracer: &dyn RayTracer,
) -> SplitMesh {
    let h = simplified.grid.voxel_size as f32;
    if options.patches == PatchSource::Surfels {
        let fragments = &simplified.fragments;
        let lit = |f: usize, side: usize| {
            let patch = fragments.patch[f][side];
            patch != NO_PATCH && light.reached[patch as usize]
        };
        let wanted = |f: usize, side: usize| lit(f, side) || (side == 0 && !lit(f, 1));
        return simplify::split_mesh(scene, fragments, h, tracer, wanted);
    }
    let fragments = simplify::clip(scene, &simplified.grid);
    let cos_threshold = options.normal_threshold.to_radians().cos();
    let lit = |f: usize, side: usize| {
        let t = fragments.triangle[f] as usize;
        let normal = if side == 1 { -scene.normal(t) } else { scene.normal(t) };
        let middle = simplify::clip::point_at(&scene.corners_of(t), simplify::clip::uv_centroid(fragments.uv(f)));
        let mut found = false;
        index.near(middle, 1.0, |j| {
            let ahead = (simplified.patches.centroid[j] - middle).dot(normal) > -0.01 * h;
            found |= ahead && light.reached[j] && simplified.patches.normal[j].dot(normal) >= cos_threshold;
        });
        found
    };
    let two_sided = |f: usize| scene.triangles[fragments.triangle[f] as usize].two_sided;
    let wanted = |f: usize, side: usize| {
        if side == 0 { !two_sided(f) || lit(f, 0) || !lit(f, 1) } else { two_sided(f) && lit(f, 1) }
    };
    let mut mesh = simplify::split_mesh(scene, &fragments, h, tracer, wanted);
    mesh.patch.fill(NO_PATCH);
    mesh
}

fn rgb(v: Vec3) -> [f64; 3] {
    v.to_array().map(f64::from)
}

fn vec3(v: [f64; 3]) -> Vec3 {
    // Finite, however strong the lights are.
    Vec3::from_array(v.map(|x| x as f32)).min(Vec3::MAX)
}

/// Times the stages.
struct Clock {
    last: Instant,
    stages: Vec<Stage>,
}

impl Clock {
    fn new() -> Clock {
        Clock { last: Instant::now(), stages: Vec::new() }
    }

    /// Ends a stage; its seconds.
    fn stop(&mut self, name: &'static str) -> f64 {
        let seconds = self.last.elapsed().as_secs_f64();
        self.stages.push(Stage { name, seconds });
        self.last = Instant::now();
        seconds
    }
}

fn report(
    scene: &Scene,
    bake: &Bake,
    solution: &solve::Solution,
    row_rays: u64,
    visibility: u64,
    rows_seconds: f64,
    clock: Clock,
) -> Report {
    let (patches, f) = (bake.patches(), &bake.form_factors);
    let reached = bake.light.reached.iter().filter(|&&r| r).count();
    let unreached = patches.len() - reached;
    let mut skipped = Vec::new();
    if unreached > 0 {
        skipped.push(Skipped {
            what: "patches that no light reaches".into(),
            patches: unreached,
            rays: unreached as u64 * (bake.options.rays as u64).saturating_sub(64),
            error: "none of 64 probe rays of each met a lit patch, and no ray of a lit patch met it".into(),
        });
    }
    Report {
        version: env!("CARGO_PKG_VERSION").into(),
        backend: bake.tracer.name(),
        instruction_set: bake.tracer.instruction_set(),
        threads: rayon::current_num_threads(),
        settings: Some(bake.options.clone()),
        counts: Counts {
            triangles: scene.triangles.len(),
            voxel_size: bake.simplified.grid.voxel_size * scene.frame.scale,
            voxels: patches.voxel.chunk_by(|a, b| a == b).count(),
            fragments: bake.simplified.fragments.len(),
            patches: patches.len(),
            patches_reached: reached,
            vertices: bake.mesh.positions.len(),
            form_factors: f.nonzeros(),
            form_factor_bytes: f.size_in_bytes(),
        },
        stages: clock.stages,
        rays: Rays {
            form_factors: row_rays,
            form_factor_mrays_per_second: row_rays as f64 / rows_seconds * 1e-6,
            visibility,
        },
        energy: energy(bake, scene.frame.scale),
        row_sums: row_sums(f),
        solver: Solver { method: "bicgstab", iterations: solution.iterations, residual: solution.residual },
        skipped,
        warnings: scene.warnings.clone(),
        ..Report::default()
    }
}

/// Balance of power over the visible surfaces, in world units.
fn energy(bake: &Bake, scale: f64) -> Energy {
    let (patches, f, light) = (bake.patches(), &bake.form_factors, &bake.light);
    let mut energy = Energy::default();
    for i in 0..patches.len() {
        let area = patches.area[i] as f64 * (1.0 - f.hidden(i)) * scale * scale;
        for c in 0..3 {
            let (direct, indirect) = (light.direct[i][c] as f64, light.indirect[i][c] as f64);
            energy.direct[c] += area * direct;
            energy.absorbed[c] += area * (direct + indirect) * (1.0 - patches.albedo[i][c] as f64);
            energy.escaped[c] += area * light.radiosity[i][c] as f64 * f.escape(i);
        }
    }
    for c in 0..3 {
        let balance = energy.direct[c] - energy.absorbed[c] - energy.escaped[c];
        energy.imbalance[c] = if energy.direct[c] > 0.0 { balance / energy.direct[c] } else { 0.0 };
    }
    energy
}

fn row_sums(f: &FormFactors) -> RowSums {
    let rows: Vec<usize> = (0..f.len()).filter(|&i| f.has_row(i)).collect();
    let sums = || rows.iter().map(|&i| f.raw_row_sum(i));
    let count = rows.len().max(1) as f64;
    RowSums {
        min: sums().fold(1.0, f64::min),
        mean: sums().sum::<f64>() / count,
        max: sums().fold(0.0, f64::max),
        closed: f.is_closed(),
        hidden: rows.iter().map(|&i| f.hidden(i)).sum::<f64>() / count,
    }
}
