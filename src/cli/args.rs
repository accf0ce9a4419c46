//! The options that every baking command takes.

use std::{path::PathBuf, time::Duration};

use clap::Args;
use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Error, Goal, Quality, Result, Scene,
    options::{PatchSource, Resolution},
    scene::{SceneOverrides, Source},
};

use super::{
    choices::{Colour, Interpolation, Patches, Preset, PrimaryLight, Sides, Tracer},
    parse,
};

/// Settings of the bake, the scene's lights, and how to tell of it.
#[derive(Args, Debug)]
pub struct BakeArgs {
    /// The scene: an OBJ, glTF or GLB file, or a scene file (.toml)
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    #[command(flatten)]
    settings: Settings,
    #[command(flatten)]
    lights: Lights,
    #[command(flatten)]
    pub running: Running,
}

/// A scene and its lights, without the settings of a bake.
#[derive(Args, Debug)]
pub struct SceneArgs {
    /// The scene: an OBJ, glTF or GLB file, or a scene file (.toml)
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    #[command(flatten)]
    tracing: Tracing,
    #[command(flatten)]
    lights: Lights,
    #[command(flatten)]
    pub running: Running,
}

/// The settings that are not those of a bake alone.
#[derive(Args, Debug)]
#[command(next_help_heading = "Tracing")]
struct Tracing {
    /// Ray tracer [default: auto]
    #[arg(long, value_enum)]
    backend: Option<Tracer>,
    /// Which sides of surfaces receive light [default: auto]
    #[arg(long, value_enum)]
    sides: Option<Sides>,
    /// Seed of all random numbers [default: 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
}

/// What is not given here is taken from the scene file's [bake] table, else from the defaults.
#[derive(Args, Debug)]
#[command(next_help_heading = "Bake settings")]
struct Settings {
    /// Grid, rays, samples and reconstruction that go well together [default: default]
    #[arg(long, value_enum)]
    quality: Option<Preset>,
    /// Voxels along the longest side of the scene, 2 to 4096 [default: 64]
    #[arg(long, value_name = "N", value_parser = parse::grid, conflicts_with = "voxel", allow_hyphen_values = true)]
    grid: Option<u32>,
    /// Voxels of this size, in scene units
    #[arg(long, value_name = "H", value_parser = parse::positive, allow_hyphen_values = true)]
    voxel: Option<f64>,
    /// What the patches are [default: surfels]
    #[arg(long, value_enum)]
    patches: Option<Patches>,
    /// Hand-made simplified mesh for `--patches proxy`, which it implies: OBJ, glTF or GLB in world coordinates
    #[arg(long, value_name = "FILE")]
    proxy: Option<PathBuf>,
    /// Patches to aim at where they are triangles of a simplified mesh [default: of a voxel face's area]
    #[arg(long, value_name = "N", value_parser = parse::target_patches, allow_hyphen_values = true)]
    target_patches: Option<u32>,
    /// Form-factor rays a patch, a power of two from 16 to 65536 [default: 256]
    #[arg(long, value_name = "N", value_parser = parse::rays, allow_hyphen_values = true)]
    rays: Option<u32>,
    /// How patch light is carried to vertices and points [default: smooth]
    #[arg(long, value_enum)]
    reconstruct: Option<Interpolation>,
    /// Rays of a vertex or point that gathers, 16 to 65536 [default: 1024]
    #[arg(long, value_name = "N", value_parser = parse::gather_rays, allow_hyphen_values = true)]
    gather_rays: Option<u32>,
    /// How primary light enters: sampled at patches and vertices, or as patches of the radiosity system
    /// [default: direct]
    #[arg(long, value_enum)]
    primary: Option<PrimaryLight>,
    /// Ray tracer [default: auto]
    #[arg(long, value_enum)]
    backend: Option<Tracer>,
    /// Which sides of surfaces receive light [default: auto]
    #[arg(long, value_enum)]
    sides: Option<Sides>,
    /// Largest angle between the normals of a vertex and a patch it takes light from, degrees [default: 60]
    #[arg(long, value_name = "DEGREES", value_parser = parse::threshold, allow_hyphen_values = true)]
    normal_threshold: Option<f32>,
    /// Shadow rays a vertex or point, for each area light and the sky [default: 64]
    #[arg(long, value_name = "N", value_parser = parse::samples, allow_hyphen_values = true)]
    point_samples: Option<u32>,
    /// Shadow rays a patch, for each area light and the sky [default: 32]
    #[arg(long, value_name = "N", value_parser = parse::samples, allow_hyphen_values = true)]
    patch_samples: Option<u32>,
    /// Largest residual of the solution, relative to the largest source [default: 1e-6]
    #[arg(long, value_name = "X", value_parser = parse::positive, allow_hyphen_values = true)]
    tolerance: Option<f64>,
    /// How colours in a voxel combine to the colour of a face (`--patches faces`) [default: normalised]
    #[arg(long, value_enum)]
    face_colour: Option<Colour>,
    /// Seed of all random numbers [default: 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Compute also what the scene does not need: bake.json lists what is left out otherwise
    #[arg(long)]
    no_skip: bool,
    /// Bake this mesh alone, in the light of the whole scene; may be repeated
    #[arg(long, value_name = "MESH")]
    only: Vec<String>,
    /// Do not estimate the error of the result
    #[arg(long)]
    no_estimate: bool,
}

/// What is asked of the result: settings are found by baking, first coarsely. Explicit --grid, --voxel, --rays and
/// --point-samples are kept.
#[derive(Args, Debug)]
#[command(next_help_heading = "Goal")]
pub struct Goals {
    /// Bake until the estimated error of the total light is at most P % of its mean
    #[arg(long, value_name = "P%", value_parser = parse::percent, allow_hyphen_values = true,
        conflicts_with_all = ["quality", "no_estimate"])]
    target_error: Option<f64>,
    /// Bake as well as the time allows, such as 30s, 5m or 1h; pictures and files not counted
    #[arg(long, value_name = "TIME", value_parser = parse::time, allow_hyphen_values = true,
        conflicts_with_all = ["quality", "no_estimate"])]
    budget: Option<Duration>,
}

/// Added to the lights of the scene.
#[derive(Args, Debug)]
#[command(next_help_heading = "Lights and materials")]
pub struct Lights {
    /// Sky of constant radiance, W/m2/sr
    #[arg(long, value_name = "R,G,B", value_parser = parse::colour, allow_hyphen_values = true)]
    sky: Option<Vec3>,
    /// Sun: direction of travel and irradiance at normal incidence, W/m2; may be repeated
    #[arg(long, value_name = "X,Y,Z:R,G,B", value_parser = parse::sun, allow_hyphen_values = true)]
    sun: Vec<(DVec3, Vec3)>,
    /// Point light: position and radiant intensity, W/sr; may be repeated
    #[arg(long, value_name = "X,Y,Z:R,G,B", value_parser = parse::point, allow_hyphen_values = true)]
    point: Vec<(DVec3, Vec3)>,
    /// Surroundings: a lat-long EXR image of radiance, up is +y
    #[arg(long, value_name = "FILE")]
    environment: Option<PathBuf>,
    /// Radiance that a material emits, W/m2/sr; may be repeated
    #[arg(long, value_name = "MATERIAL=R,G,B", value_parser = parse::emit, allow_hyphen_values = true)]
    emit: Vec<(String, Vec3)>,
    /// Diffuse albedo of a material; may be repeated
    #[arg(long, value_name = "MATERIAL=R,G,B", value_parser = parse::emit, allow_hyphen_values = true)]
    albedo: Vec<(String, Vec3)>,
}

/// How the command runs and tells.
#[derive(Args, Debug)]
#[command(next_help_heading = "Running")]
pub struct Running {
    /// Threads; the result is the same for any number [default: one a core]
    #[arg(long, value_name = "N", value_parser = parse::threads)]
    pub threads: Option<usize>,
    /// Say nothing but errors
    #[arg(long, short)]
    pub quiet: bool,
    /// Write progress to stdout, one JSON object a line, instead of bars and summary
    #[arg(long)]
    pub json_progress: bool,
}

/// What is to be baked, and how.
pub struct Job {
    pub scene: Scene,
    pub options: BakeOptions,
    /// Threads asked for.
    threads: Option<usize>,
}

impl Job {
    /// Runs `work` on as many threads as asked for, one a core if not asked.
    ///
    /// # Errors
    /// Those of `work`; the system gives no threads.
    pub fn on_threads<T: Send>(&self, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
        on_threads(self.threads, work)
    }
}

/// Runs `work` on so many threads, one a core if none are given.
///
/// # Errors
/// Those of `work`; the system gives no threads.
pub fn on_threads<T: Send>(threads: Option<usize>, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build()
        .map_err(|e| Error::Option(format!("cannot start the threads: {e}; try fewer with --threads")))?;
    pool.install(work)
}

impl BakeArgs {
    /// Loads the scene and settles how to bake it: these arguments over the scene file over the defaults.
    ///
    /// # Errors
    /// Those of [`luxel::scene::load`].
    pub fn load(&self) -> Result<Job> {
        let (source, settle) = self.read()?;
        Ok(settle(source.build()?))
    }

    /// As [`BakeArgs::load`]; with the scene as it was read.
    ///
    /// # Errors
    /// As of [`BakeArgs::load`].
    pub fn load_source(&self) -> Result<(Source, Job)> {
        let (source, settle) = self.read()?;
        let scene = source.clone().build()?;
        Ok((source, settle(scene)))
    }

    /// The scene as its file has it, and how to bake what will be built of it.
    fn read(&self) -> Result<(Source, impl FnOnce(Scene) -> Job)> {
        if let (Some(patches), Some(_)) = (self.settings.patches, &self.settings.proxy)
            && PatchSource::from(patches) != PatchSource::Proxy
        {
            return Err(Error::Option("--proxy gives the patches: leave --patches out, or make it proxy".into()));
        }
        let (source, file) = Source::load(&self.scene, &self.overrides())?;
        let mut base = BakeOptions::default();
        file.apply(&mut base);
        if let Some(quality) = self.settings.quality {
            Quality::from(quality).apply(&mut base);
        }
        let (options, threads) = (self.options(base), self.running.threads.or(file.threads));
        self.settings.check_used(&options)?;
        Ok((source, move |scene| Job { scene, options, threads }))
    }

    /// What is asked of the bake.
    pub fn goal(&self, goals: &Goals) -> Goal {
        let s = &self.settings;
        Goal {
            target_error: goals.target_error,
            budget: goals.budget,
            fixed_resolution: s.grid.is_some() || s.voxel.is_some(),
            fixed_rays: s.rays.is_some(),
            fixed_samples: s.point_samples.is_some(),
        }
    }

    fn options(&self, base: BakeOptions) -> BakeOptions {
        let s = &self.settings;
        let implied = s.proxy.as_ref().map(|_| PatchSource::Proxy);
        let resolution = s.grid.map(Resolution::Grid).or(s.voxel.map(Resolution::Voxel));
        BakeOptions {
            resolution: resolution.unwrap_or(base.resolution),
            patches: s.patches.map(Into::into).or(implied).unwrap_or(base.patches),
            target_patches: s.target_patches.or(base.target_patches),
            rays: s.rays.unwrap_or(base.rays),
            reconstruct: s.reconstruct.map_or(base.reconstruct, Into::into),
            gather_rays: s.gather_rays.unwrap_or(base.gather_rays),
            primary: s.primary.map_or(base.primary, Into::into),
            backend: s.backend.map_or(base.backend, Into::into),
            face_colour: s.face_colour.map_or(base.face_colour, Into::into),
            normal_threshold: s.normal_threshold.unwrap_or(base.normal_threshold),
            point_samples: s.point_samples.unwrap_or(base.point_samples),
            patch_samples: s.patch_samples.unwrap_or(base.patch_samples),
            tolerance: s.tolerance.unwrap_or(base.tolerance),
            seed: s.seed.unwrap_or(base.seed),
            estimate: base.estimate && !s.no_estimate,
            skip: base.skip && !s.no_skip,
            only: if s.only.is_empty() { base.only } else { s.only.clone() },
        }
    }
}

impl Settings {
    /// Finds options that nothing would use, as the others are.
    ///
    /// # Errors
    /// [`Error::Option`] that says what the option is for.
    fn check_used(&self, options: &BakeOptions) -> Result<()> {
        let simplifies = matches!(options.patches, PatchSource::Decimated | PatchSource::Clustered);
        let unused = [
            (self.target_patches.is_some() && !simplifies, "--target-patches is for --patches decimated or clustered"),
            (
                self.face_colour.is_some() && options.patches != PatchSource::Faces,
                "--face-colour is for --patches faces",
            ),
            (
                self.gather_rays.is_some() && !options.reconstruct.gathers(),
                "--gather-rays is for --reconstruct gather or adaptive",
            ),
        ];
        let found = unused.into_iter().find(|(unused, _)| *unused);
        found.map_or(Ok(()), |(_, message)| Err(Error::Option(message.into())))
    }
}

impl BakeArgs {
    fn overrides(&self) -> SceneOverrides {
        SceneOverrides { proxy: self.settings.proxy.clone(), ..self.lights.overrides(self.settings.sides) }
    }
}

impl SceneArgs {
    /// Loads the scene; of the options only backend and seed have a meaning.
    ///
    /// # Errors
    /// Those of [`luxel::scene::load`].
    pub fn load(&self) -> Result<Job> {
        let (scene, file) = luxel::scene::load(&self.scene, &self.lights.overrides(self.tracing.sides))?;
        let mut options = BakeOptions::default();
        file.apply(&mut options);
        options.backend = self.tracing.backend.map_or(options.backend, Into::into);
        options.seed = self.tracing.seed.unwrap_or(options.seed);
        Ok(Job { scene, options, threads: self.running.threads.or(file.threads) })
    }
}

impl Lights {
    /// What they change in a scene.
    pub fn overrides(&self, sides: Option<Sides>) -> SceneOverrides {
        SceneOverrides {
            sky: self.sky,
            suns: self.sun.clone(),
            points: self.point.clone(),
            environment: self.environment.clone(),
            emit: self.emit.clone(),
            albedo: self.albedo.clone(),
            sides: sides.map(Into::into),
            ..SceneOverrides::default()
        }
    }
}
