//! The options that every baking command takes.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Error, Result, Scene,
    options::{Backend, FaceColour, PatchSource, Primary, Reconstruct, Resolution},
    scene::{SceneOverrides, SidesRule},
};

use super::parse;

/// Settings of the bake, the scene's lights, and how to tell of it.
#[derive(Args, Debug)]
pub struct BakeArgs {
    /// The scene: an OBJ, glTF or GLB file, or a scene file (.toml)
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    #[command(flatten)]
    settings: Settings,
    #[command(flatten)]
    lights: Lights,
    #[command(flatten)]
    pub running: Running,
}

/// What is not given here is taken from the scene file's [bake] table, else from the defaults.
#[derive(Args, Debug)]
#[command(next_help_heading = "Bake settings")]
struct Settings {
    /// Voxels along the longest side of the scene, 2 to 4096 [default: 64]
    #[arg(long, value_name = "N", value_parser = parse::grid, conflicts_with = "voxel", allow_hyphen_values = true)]
    grid: Option<u32>,
    /// Voxels of this size, in scene units
    #[arg(long, value_name = "H", value_parser = parse::positive, allow_hyphen_values = true)]
    voxel: Option<f64>,
    /// What the patches are: pieces of the real surfaces, or the paper's voxel faces [default: surfels]
    #[arg(long, value_enum)]
    patches: Option<Patches>,
    /// Form-factor rays a patch, a power of two from 16 to 65536 [default: 256]
    #[arg(long, value_name = "N", value_parser = parse::rays, allow_hyphen_values = true)]
    rays: Option<u32>,
    /// How patch light is carried to vertices and points: local least squares, or the paper's four nearest patches
    /// [default: smooth]
    #[arg(long, value_enum)]
    reconstruct: Option<Interpolation>,
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
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Compute also what the scene does not need: bake.json lists what is left out otherwise
    #[arg(long)]
    no_skip: bool,
    /// Bake this mesh alone, in the light of the whole scene; may be repeated
    #[arg(long, value_name = "MESH")]
    only: Vec<String>,
}

/// Added to the lights of the scene.
#[derive(Args, Debug)]
#[command(next_help_heading = "Lights and materials")]
struct Lights {
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
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads.unwrap_or(0))
            .build()
            .map_err(|e| Error::Option(format!("cannot start the threads: {e}; try fewer with --threads")))?;
        pool.install(work)
    }
}

impl BakeArgs {
    /// Loads the scene and settles how to bake it: these arguments over the scene file over the defaults.
    ///
    /// # Errors
    /// Those of [`luxel::scene::load`].
    pub fn load(&self) -> Result<Job> {
        let (scene, file) = luxel::scene::load(&self.scene, &self.overrides())?;
        let mut base = BakeOptions::default();
        file.apply(&mut base);
        Ok(Job { scene, options: self.options(base), threads: self.running.threads.or(file.threads) })
    }

    fn options(&self, base: BakeOptions) -> BakeOptions {
        let s = &self.settings;
        let resolution = s.grid.map(Resolution::Grid).or(s.voxel.map(Resolution::Voxel));
        BakeOptions {
            resolution: resolution.unwrap_or(base.resolution),
            patches: s.patches.map_or(base.patches, Into::into),
            rays: s.rays.unwrap_or(base.rays),
            reconstruct: s.reconstruct.map_or(base.reconstruct, Into::into),
            primary: s.primary.map_or(base.primary, Into::into),
            backend: s.backend.map_or(base.backend, Into::into),
            face_colour: s.face_colour.map_or(base.face_colour, Into::into),
            normal_threshold: s.normal_threshold.unwrap_or(base.normal_threshold),
            point_samples: s.point_samples.unwrap_or(base.point_samples),
            patch_samples: s.patch_samples.unwrap_or(base.patch_samples),
            tolerance: s.tolerance.unwrap_or(base.tolerance),
            seed: s.seed.unwrap_or(base.seed),
            skip: base.skip && !s.no_skip,
            only: if s.only.is_empty() { base.only } else { s.only.clone() },
        }
    }

    fn overrides(&self) -> SceneOverrides {
        SceneOverrides {
            sky: self.lights.sky,
            suns: self.lights.sun.clone(),
            points: self.lights.point.clone(),
            environment: self.lights.environment.clone(),
            emit: self.lights.emit.clone(),
            albedo: self.lights.albedo.clone(),
            sides: self.settings.sides.map(Into::into),
        }
    }
}

/// Declares the values of an option and what they stand for.
macro_rules! choice {
    ($name:ident for $target:ty { $($(#[$doc:meta])* $value:ident),+ $(,)? }) => {
        #[derive(Clone, Copy, Debug, ValueEnum)]
        enum $name { $($(#[$doc])* $value),+ }

        impl From<$name> for $target {
            fn from(choice: $name) -> $target {
                match choice { $($name::$value => <$target>::$value),+ }
            }
        }
    };
}

choice!(Patches for PatchSource {
    /// Pieces of the real surfaces, grouped by voxel and direction
    Surfels,
    /// The paper's method: equal square faces of the voxels
    Faces,
});
choice!(Interpolation for Reconstruct {
    /// Local linear least squares over visible patches
    Smooth,
    /// The paper's four nearest patches by inverse distance
    Nearest4,
});
choice!(PrimaryLight for Primary {
    /// Sampled at patches and vertices
    Direct,
    /// Emitting surfaces are patches of the radiosity system
    Radiosity,
});
choice!(Tracer for Backend {
    /// Embree where it is compiled in, else bvh
    Auto,
    /// Intel Embree
    Embree,
    /// Pure Rust (obvhs)
    Bvh,
    /// Every triangle against every ray: exact, slow
    Brute,
});
choice!(Colour for FaceColour {
    /// Mean, weighted by projected area
    Normalised,
    /// The literal sum of colour times projected area over face area
    Literal,
});
choice!(Sides for SidesRule {
    /// Closed solids and rooms one side, open sheets two
    Auto,
    /// The side that the winding says
    One,
    /// Both
    Two,
});
