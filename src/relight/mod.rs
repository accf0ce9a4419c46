//! Light that changes while it is looked at.
//!
//! Form factors, the neighbours of vertices and the places on patches where shadow rays start depend on geometry alone. A
//! [`Relighter`] keeps them unpacked in memory, with the last solution, so that a frame with a light somewhere else takes
//! shadow rays to that light from the patches, a few sweeps over the system, and one sum a vertex.

use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    BakeOptions, Error, Result, Scene,
    bake::{Bake, RelitLight},
    light::{self, LightSet},
    options::PatchSource,
    reconstruct::Factors,
    scene::SurfacePoint,
    transfer::Rows,
};

mod changes;
mod frame;
mod orbit;
mod sent;
mod solution;
mod source;
mod transport;

pub use orbit::{middle, orbit, outward};
pub use source::Source;

use sent::Sent;
use solution::Solution;
use transport::Transport;

/// How well a frame is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelightOptions {
    /// Shadow rays a patch for each light, a power of two up to 65536.
    pub patch_samples: u32,
    /// Shadow rays a vertex for each light.
    pub point_samples: u32,
    /// Error at which the solution is good enough: what more bounces would still change, summed over the patches, as a share
    /// of all radiosity. Between 0 and 1.
    pub tolerance: f64,
}

/// What it took to bring indirect light up to date.
#[derive(Clone, Copy, Debug, Default)]
pub struct Frame {
    /// Shadow rays: of patches to lights and bright patches, and of vertices to bright patches.
    pub rays: u64,
    /// Sweeps over the radiosity system.
    pub sweeps: usize,
    /// What more sweeps would still change, as [`RelightOptions::tolerance`] counts it: an estimate.
    pub residual: f64,
    /// Time of the patches' direct light, of the solution, and of the vertices' indirect light, seconds.
    pub seconds: [f64; 3],
}

/// Error of the solution unless asked for otherwise.
const TOLERANCE: f64 = 1e-3;
/// A patch that is all but hidden is not trusted with more than one over this factor.
const LEAST_SEEN: f32 = 0.05;

/// The lights of a scene as a [`Relighter`] of it numbers them before any is added: those that are no surfaces, then one for
/// each emitting material in the order of the materials.
pub fn sources(scene: &Scene) -> Vec<Source> {
    let lights = scene.lights.iter().enumerate().map(|(i, light)| Source::of_scene(i, light, scene));
    let emitting = (0..scene.triangles.len()).filter(|&t| scene.emission(t) != Vec3::ZERO);
    let mut materials: Vec<u32> = emitting.map(|t| scene.triangles[t].material).collect();
    materials.sort_unstable();
    materials.dedup();
    lights.chain(materials.into_iter().map(|m| Source::of_material(m, scene))).collect()
}

/// A baked scene whose lights and albedos can be changed at frame rate.
///
/// Lights: those of [`sources`], then those that were added. A moved light blocks no rays. If it is a material, its triangles stay where they are and are dark
/// from then on; they still block rays.
pub struct Relighter {
    scene: Scene,
    bake: Bake,
    options: RelightOptions,
    sources: Vec<Source>,
    /// Direct irradiance by source: of the patches that exchange light, and of the vertices; empty if out of date.
    patch_direct: Vec<Vec<Vec3>>,
    vertex_direct: Vec<Vec<Vec3>>,
    transport: Transport,
    factors: Factors,
    /// Where shadow rays of the patches that exchange light start.
    points: Vec<SurfacePoint>,
    /// One over the share of each that is not hidden inside objects.
    shown: Vec<f32>,
    solution: Solution,
    /// What bright patches send, if there are any.
    sent: Option<Sent>,
    /// Whether indirect light is up to date.
    lit: bool,
    /// Whether what patches and vertices show of the materials is up to date.
    coloured: bool,
}

impl Relighter {
    /// Takes over the bake of `scene`, with as many shadow rays as the bake had, and a tolerance of 0.1 %.
    ///
    /// Light is exchanged between the patches that have rows: those that the bake's lights reach, or all if it left nothing
    /// out (`BakeOptions::skip`). What a new light reaches besides gets direct light alone. Vertices interpolate: a bake
    /// that gathers is continued by least squares.
    ///
    /// # Errors
    /// [`Error::Option`] if the patches of the bake are not pieces of the surfaces, or `scene` is another one.
    pub fn new(scene: Scene, bake: Bake) -> Result<Relighter> {
        Relighter::check(&bake.options)?;
        if bake.simplified.geometry.positions != scene.positions
            || bake.simplified.geometry.triangles.len() != scene.triangles.len()
        {
            return Err(Error::Option(format!("scene \"{}\" is not the one of this bake", scene.name)));
        }
        let options = RelightOptions {
            patch_samples: bake.options.patch_samples,
            point_samples: bake.options.point_samples,
            tolerance: TOLERANCE,
        };
        let sources = sources(&scene);
        let transport = Transport::new(&bake.form_factors);
        let mut relighter = Relighter {
            factors: bake.factors().renamed(&transport.places(bake.form_factors.len())),
            shown: transport
                .patches
                .iter()
                .map(|&i| 1.0 / (1.0 - bake.form_factors.hidden(i as usize) as f32).max(LEAST_SEEN))
                .collect(),
            solution: Solution::new(&transport),
            sent: None,
            patch_direct: vec![Vec::new(); sources.len()],
            vertex_direct: vec![Vec::new(); sources.len()],
            points: Vec::new(),
            lit: false,
            coloured: true,
            scene,
            options,
            sources,
            transport,
            bake,
        };
        let light = &relighter.bake.smooth;
        for (e, &i) in relighter.solution.irradiance.iter_mut().zip(&relighter.transport.patches) {
            *e = light[i as usize].extend(0.0);
        }
        relighter.take_albedo();
        relighter.place_points();
        Ok(relighter)
    }

    /// Whether bakes with these options can be taken over: tells that before one is made.
    ///
    /// # Errors
    /// [`Error::Option`] if patches are not pieces of the surfaces.
    pub fn check(options: &BakeOptions) -> Result<()> {
        if options.patches == PatchSource::Surfels {
            return Ok(());
        }
        Err(Error::Option("relighting needs patches that are pieces of the surfaces: --patches surfels".into()))
    }

    /// As [`Relighter::new`], but light is exchanged between all patches that have a row in `rows`: those that
    /// [`bake::prepare`](crate::bake::prepare) made before the bake, for any lights.
    ///
    /// # Errors
    /// Those of [`Relighter::new`]; [`Error::Option`] if the rows are not of this bake's patches.
    pub fn with_rows(scene: Scene, mut bake: Bake, rows: &Rows) -> Result<Relighter> {
        if rows.patches() != bake.simplified.patches.len() {
            return Err(Error::Option("the rows are not those of this bake's patches".into()));
        }
        bake.take_rows(rows);
        Relighter::new(scene, bake)
    }

    /// Computes frames otherwise from now on.
    ///
    /// # Errors
    /// [`Error::Option`] for numbers without sense.
    pub fn set_options(&mut self, options: RelightOptions) -> Result<()> {
        let sound = |samples: u32| (1..=65536).contains(&samples);
        if !sound(options.patch_samples) || !sound(options.point_samples) {
            return Err(Error::Option("shadow samples must be from 1 to 65536".into()));
        }
        if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
            return Err(Error::Option(format!("tolerance {} is not between 0 and 1", options.tolerance)));
        }
        if options.point_samples != self.options.point_samples {
            self.vertex_direct.iter_mut().for_each(Vec::clear);
        }
        let places = options.patch_samples != self.options.patch_samples;
        self.options = options;
        if places {
            self.patch_direct.iter_mut().for_each(Vec::clear);
            self.place_points();
        }
        self.lit = false;
        Ok(())
    }

    /// How frames are computed.
    pub fn options(&self) -> RelightOptions {
        self.options
    }

    /// The scene as it is lit now; materials that were moved away are dark in it.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The lights.
    pub fn sources(&self) -> &[Source] {
        &self.sources
    }

    /// Brings the indirect light of the vertices up to date; see [`Relighter::indirect`]. Same lights, same bits but for the
    /// solution, which depends within the tolerance on those before it.
    pub fn frame(&mut self) -> Frame {
        let mut frame = Frame::default();
        if self.lit {
            return frame;
        }
        let begun = Instant::now();
        frame.rays = self.light_patches();
        let lit = Instant::now();
        (frame.sweeps, frame.residual) = self.solve();
        let solved = Instant::now();
        frame.rays += self.light_vertices();
        self.lit = true;
        frame.seconds = [lit - begun, solved - lit, solved.elapsed()].map(|t| t.as_secs_f64());
        frame
    }

    /// Indirect irradiance of the vertices of the bake's mesh as of the last [`Relighter::frame`], W/m2.
    pub fn indirect(&self) -> &[Vec3] {
        &self.bake.vertices.indirect
    }

    /// Direct irradiance of the vertices of the bake's mesh, W/m2: brought up to date by shadow rays from each.
    pub fn direct(&mut self) -> &[Vec3] {
        let points = &self.bake.mesh.samples;
        for (source, direct) in self.sources.iter().zip(&mut self.vertex_direct).filter(|s| s.1.is_empty()) {
            let (samples, seed) = (self.options.point_samples, self.bake.options.seed);
            *direct = light::irradiance_of_few(&source.lights, self.bake.tracer(), points, 1, samples, seed).irradiance;
        }
        let all = &self.vertex_direct;
        let sum = |v: usize| all.iter().map(|direct| direct[v]).sum::<Vec3>().min(Vec3::MAX);
        self.bake.vertices.direct = (0..points.len()).into_par_iter().with_min_len(4096).map(sum).collect();
        &self.bake.vertices.direct
    }

    /// The bake as it is lit now, with all that can be asked of one: light at points, pictures, files. Its report is that of
    /// the bake that was taken over; it has no estimate of its error.
    pub fn bake(&mut self) -> &Bake {
        self.frame();
        self.direct();
        if !self.coloured {
            self.colour();
        }
        let lights = LightSet::union(self.sources.iter().map(|s| &s.lights));
        let count = self.bake.simplified.patches.len();
        let spread = |of: &dyn Fn(usize) -> Vec3| {
            let mut all = vec![Vec3::ZERO; count];
            self.transport.patches.iter().enumerate().for_each(|(k, &i)| all[i as usize] = of(k).min(Vec3::MAX));
            all
        };
        let direct = spread(&|k| self.direct_of(k));
        let smooth = spread(&|k| self.solution.irradiance[k].truncate());
        let carried = spread(&|k| self.solution.radiosity[k].truncate());
        let (mut indirect, mut radiosity) = (smooth.clone(), carried.clone());
        if let Some(sent) = &self.sent {
            for (&i, e) in self.transport.patches.iter().zip(&sent.received) {
                indirect[i as usize] = (indirect[i as usize] + e.truncate()).min(Vec3::MAX);
            }
            for (i, b) in sent.exitance() {
                radiosity[i as usize] = (radiosity[i as usize] + b).min(Vec3::MAX);
            }
        }
        let bright = self.sent.as_ref().map(|sent| sent.lights(&self.bake));
        let light = RelitLight { lights, bright, direct, indirect, smooth, radiosity, carried };
        self.bake.relight(light);
        &self.bake
    }

    /// The scene and the bake together as [`Relighter::bake`] left them.
    pub fn lit(&self) -> (&Scene, &Bake) {
        (&self.scene, &self.bake)
    }
}
