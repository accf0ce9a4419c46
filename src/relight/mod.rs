//! Light that changes while it is looked at.
//!
//! Form factors, the neighbours of vertices and the places on patches where shadow rays start depend on geometry alone. A
//! [`Relighter`] keeps them unpacked in memory, with the last solution, so that a frame with a light somewhere else takes
//! shadow rays to that light from the patches, a few sweeps over the system, and one sum a vertex.

use std::time::Instant;

use glam::{DAffine3, Vec3};
use rayon::prelude::*;

use crate::{
    Error, Result, Scene,
    bake::Bake,
    light::{self, LightSet},
    options::PatchSource,
    reconstruct::Factors,
    scene::{SurfacePoint, WorldLight, list, material::ALBEDO_MAX},
    simplify, solve,
    transfer::{self, Rows},
};

mod orbit;
mod solution;
mod source;
mod transport;

pub use orbit::{middle, orbit};
pub use source::Source;

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
    /// Shadow rays from patches.
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

/// A baked scene whose lights and albedos can be changed at frame rate.
///
/// Lights: the scene's own in their order, then one for each emitting material in the order of the materials, then
/// those that were added. A moved light blocks no rays. If it is a material, its triangles stay where they are and are dark
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
    /// that gathers is continued by least squares. There are no bright patches: all reflected light goes by form factors.
    ///
    /// # Errors
    /// [`Error::Option`] if the patches of the bake are not pieces of the surfaces, or `scene` is another one.
    pub fn new(scene: Scene, bake: Bake) -> Result<Relighter> {
        if bake.options.patches != PatchSource::Surfels {
            return Err(Error::Option(
                "relighting needs patches that are pieces of the surfaces: --patches surfels".into(),
            ));
        }
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
        let mut sources: Vec<Source> =
            scene.lights.iter().enumerate().map(|(i, light)| Source::of_scene(i, light, &scene)).collect();
        let emitting = (0..scene.triangles.len()).filter(|&t| scene.emission(t) != Vec3::ZERO);
        let mut materials: Vec<u32> = emitting.map(|t| scene.triangles[t].material).collect();
        materials.sort_unstable();
        materials.dedup();
        sources.extend(materials.into_iter().map(|m| Source::of_material(m, &scene)));

        let transport = Transport::new(&bake.form_factors);
        let mut relighter = Relighter {
            factors: bake.factors().renamed(&transport.places(bake.form_factors.len())),
            shown: transport
                .patches
                .iter()
                .map(|&i| 1.0 / (1.0 - bake.form_factors.hidden(i as usize) as f32).max(LEAST_SEEN))
                .collect(),
            solution: Solution::new(&transport),
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
        let light = &relighter.bake.light.indirect;
        for (e, &i) in relighter.solution.irradiance.iter_mut().zip(&relighter.transport.patches) {
            *e = light[i as usize].extend(0.0);
        }
        relighter.take_albedo();
        relighter.place_points();
        Ok(relighter)
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

    /// Puts a light somewhere else: `place` maps where it was when it was given (world coordinates) to where it shall be.
    /// Suns and spots turn with it; points and skies do not.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such light, or `place` is not finite or leaves nothing of it.
    pub fn place(&mut self, source: usize, place: DAffine3) -> Result<()> {
        let placed = self.source(source)?.placed(place, &self.scene)?;
        self.replace(source, placed);
        Ok(())
    }

    /// Exchanges one of the scene's lights, or an added one, for another.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such light, if it is a material, or if the new one has numbers without sense.
    pub fn set_light(&mut self, source: usize, light: WorldLight) -> Result<()> {
        let old = self.source(source)?;
        if old.light().is_none() {
            return Err(Error::Option(format!("{} is no free light: set its emission instead", old.name())));
        }
        let new = Source::of_light(source, light, &self.scene)?;
        self.replace(source, new);
        Ok(())
    }

    /// Adds a light and returns its number.
    ///
    /// # Errors
    /// [`Error::Option`] for numbers without sense.
    pub fn add_light(&mut self, light: WorldLight) -> Result<usize> {
        let number = self.sources.len();
        self.sources.push(Source::of_light(number, light, &self.scene)?);
        self.patch_direct.push(Vec::new());
        self.vertex_direct.push(Vec::new());
        self.lit = false;
        Ok(number)
    }

    /// Sets the radiance (W/m2/sr) of all materials called `name`, where they stand or were moved to; a texture of the
    /// emission is dropped.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such material, or `radiance` is negative or not finite.
    pub fn set_emission(&mut self, name: &str, radiance: Vec3) -> Result<()> {
        if !(radiance.is_finite() && radiance.min_element() >= 0.0) {
            return Err(Error::Option(format!(
                "radiance {radiance} must have three numbers that are finite and not negative"
            )));
        }
        for material in self.materials(name)? {
            let surface = &mut self.scene.materials[material as usize];
            (surface.emission, surface.emission_texture) = (radiance, None);
            let new = Source::of_material(material, &self.scene);
            match self.sources.iter().position(|s| s.surface().is_some_and(|s| s.0 == material)) {
                Some(i) => {
                    let placed = new.placed(self.sources[i].place(), &self.scene)?;
                    self.replace(i, placed);
                }
                None => {
                    self.sources.push(new);
                    self.patch_direct.push(Vec::new());
                    self.vertex_direct.push(Vec::new());
                    self.lit = false;
                }
            }
        }
        self.coloured = false;
        Ok(())
    }

    /// Sets the albedo of all materials called `name`; a texture of it is dropped. Vertex colours still multiply it.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such material, or `albedo` is not from 0 to 0.9999.
    pub fn set_albedo(&mut self, name: &str, albedo: Vec3) -> Result<()> {
        if !(albedo.min_element() >= 0.0 && albedo.max_element() <= ALBEDO_MAX) {
            return Err(Error::Option(format!("albedo {albedo} must have three numbers from 0 to {ALBEDO_MAX}")));
        }
        for material in self.materials(name)? {
            let surface = &mut self.scene.materials[material as usize];
            (surface.albedo, surface.albedo_texture) = (albedo, None);
        }
        self.colour();
        self.take_albedo();
        self.lit = false;
        Ok(())
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
        self.factors.carry(&self.solution.irradiance, &mut self.bake.vertices.indirect);
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
        let indirect = spread(&|k| self.solution.irradiance[k].truncate());
        let radiosity = spread(&|k| self.solution.radiosity[k].truncate());
        self.bake.relight(lights, direct, indirect, radiosity);
        &self.bake
    }

    /// The scene and the bake together as [`Relighter::bake`] left them.
    pub fn lit(&self) -> (&Scene, &Bake) {
        (&self.scene, &self.bake)
    }

    fn source(&self, source: usize) -> Result<&Source> {
        let count = self.sources.len();
        self.sources
            .get(source)
            .ok_or_else(|| Error::Option(format!("there is no light {source}: there are {count}, counted from 0")))
    }

    /// The materials called `name`.
    fn materials(&self, name: &str) -> Result<Vec<u32>> {
        let materials = &self.scene.materials;
        let found: Vec<u32> = (0..).zip(materials).filter(|m| m.1.name == name).map(|m| m.0).collect();
        if found.is_empty() {
            let names: Vec<String> = materials.iter().map(|m| format!("\"{}\"", m.name)).collect();
            return Err(Error::Option(format!("there is no material \"{name}\"; there are {}", list(&names, 30))));
        }
        Ok(found)
    }

    fn replace(&mut self, source: usize, new: Source) {
        if let Some((material, radiance)) = new.surface() {
            // Triangles whose light has gone elsewhere are dark.
            let shines = new.place() == DAffine3::IDENTITY;
            let emission = if shines { radiance } else { Vec3::ZERO };
            let old = std::mem::replace(&mut self.scene.materials[material as usize].emission, emission);
            self.coloured &= old == emission;
        }
        self.sources[source] = new;
        self.patch_direct[source].clear();
        self.vertex_direct[source].clear();
        self.lit = false;
    }

    /// Direct irradiance of the patch of a row, over the part of it that is not hidden.
    fn direct_of(&self, row: usize) -> Vec3 {
        let sum: Vec3 = self.patch_direct.iter().map(|direct| direct[row]).sum();
        (sum * self.shown[row]).min(Vec3::MAX)
    }

    /// Direct light of the patches from the sources that have changed, and what the patches reflect of that of all; the
    /// shadow rays that it took.
    fn light_patches(&mut self) -> u64 {
        let (samples, seed) = (self.options.patch_samples, self.bake.options.seed);
        let mut rays = 0;
        for (source, direct) in self.sources.iter().zip(&mut self.patch_direct).filter(|s| s.1.is_empty()) {
            let result = light::irradiance_of_few(
                &source.lights,
                self.bake.tracer(),
                &self.points,
                samples as usize,
                samples,
                seed,
            );
            rays += result.rays;
            *direct = result.irradiance;
        }
        let reflected = |k: usize| self.solution.albedo[k] * self.direct_of(k).extend(0.0);
        self.solution.source = (0..self.transport.len()).into_par_iter().with_min_len(4096).map(reflected).collect();
        rays
    }

    /// Solves for indirect light; the sweeps, and what is left to do as a share of all radiosity.
    fn solve(&mut self) -> (usize, f64) {
        let tolerance = self.options.tolerance;
        let (sweeps, rest) = self.solution.solve(&self.transport, tolerance);
        if rest <= tolerance {
            return (sweeps, rest);
        }
        // Surfaces so white that light stays on them for very many reflections, or numbers beyond f32.
        let patches = &self.transport.patches;
        let (mut source, mut albedo) = (vec![[0.0; 3]; self.bake.form_factors.len()], Vec::new());
        albedo.extend(self.bake.simplified.patches.albedo.iter().map(|a| a.to_array().map(f64::from)));
        for (k, &i) in patches.iter().enumerate() {
            source[i as usize] = self.solution.source[k].truncate().to_array().map(f64::from);
        }
        let exact = solve::solve(&self.bake.form_factors, &albedo, &source, 0.1 * tolerance, false);
        let value = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32)).min(Vec3::MAX).extend(0.0);
        for (k, &i) in patches.iter().enumerate() {
            self.solution.radiosity[k] = value(exact.radiosity[i as usize]);
            self.solution.irradiance[k] = value(exact.irradiance[i as usize]);
        }
        (sweeps + 2 * exact.iterations, exact.residual)
    }

    /// Where shadow rays of the patches start.
    fn place_points(&mut self) {
        let (samples, seed) = (self.options.patch_samples, self.bake.options.seed);
        self.points = transfer::patch_points(&self.bake.simplified, &self.transport.patches, samples, seed);
    }

    /// Colours of patches and vertices, by the materials as they are now.
    fn colour(&mut self) {
        simplify::colour(&mut self.bake.simplified, &self.scene);
        self.bake.mesh.recolour(&self.scene);
        self.coloured = true;
    }

    /// Albedo of the patches, for the solution.
    fn take_albedo(&mut self) {
        let albedo = &self.bake.simplified.patches.albedo;
        self.solution.albedo = self.transport.patches.iter().map(|&i| albedo[i as usize].extend(0.0)).collect();
    }
}
