//! Which rows and rays the results need.

use glam::Vec3;

use super::PatchLight;
use crate::{
    BakeOptions, Result, Scene,
    light::{Census, LightSet},
    options::PatchSource,
    progress::Progress,
    reconstruct::{Level, PatchIndex},
    simplify::Simplified,
    skip::{Foresight, Sky, Wanted},
    trace::RayTracer,
    transfer::{self, Casting, Estimate, FormFactors, Plan, RowKeeper, RowPoints, Rows},
};

/// Which rows are needed.
pub(super) struct Needs {
    /// Whether patches are pieces of the surfaces that shadow and visibility rays are traced against.
    real: bool,
    /// Whether all rows are.
    all: bool,
    /// With `only`: patches of the wanted meshes, and those whose light is carried to them.
    pub near: Option<[Vec<bool>; 2]>,
    /// Patches that no surface lies before.
    pub outer: Vec<bool>,
    /// With `only`: patches without albedo.
    black: Vec<bool>,
}

impl Needs {
    pub fn new(
        scene: &Scene,
        simplified: &Simplified,
        index: &PatchIndex,
        options: &BakeOptions,
        only: Option<&Wanted>,
        foresight: &Foresight,
    ) -> Needs {
        let real = options.skip && options.patches == PatchSource::Surfels;
        let near = only.filter(|_| real).map(|only| only.patches(scene, simplified, index));
        let outer = if real { foresight.outer.patches(simplified) } else { Vec::new() };
        let black = |a: &Vec3| near.is_some() && *a == Vec3::ZERO;
        let black = simplified.patches.albedo.iter().map(black).collect();
        Needs { real, all: !options.skip, near, outer, black }
    }

    /// Which rows are cast for light that starts at the patches `lit`.
    pub fn plan<'a>(&'a self, lit: &'a [bool]) -> Plan<'a> {
        let start = self.near.as_ref().map_or(lit, |[_, near]| near);
        Plan { start, all: self.all, backwards: self.near.is_some(), black: &self.black }
    }

    /// How rows are cast.
    pub fn casting<'a>(
        &'a self,
        simplified: &'a Simplified,
        tracer: &'a dyn RayTracer,
        points: &'a RowPoints,
        marked: bool,
    ) -> Casting<'a> {
        Casting { marked, ..Casting::new(simplified, tracer, &self.outer, points) }
    }

    /// The rows, for light that starts at the patches `lit`.
    ///
    /// # Errors
    /// Those of `keeper`.
    pub fn estimate(
        &self,
        casting: &Casting,
        lit: &[bool],
        rows: &mut Rows,
        keeper: &mut dyn RowKeeper,
        progress: &dyn Progress,
    ) -> Result<Estimate> {
        let mut estimate = transfer::estimate_plan(casting, &self.plan(lit), rows, keeper, progress)?;
        if self.near.is_some() {
            // All that is lit may send light to the wanted meshes, by shadow rays too.
            estimate.reached.iter_mut().zip(lit).for_each(|(reached, lit)| *reached |= lit);
        }
        Ok(estimate)
    }

    /// Learns from the rows what the points need not ask.
    pub fn learn(&self, foresight: &mut Foresight, simplified: &Simplified, f: &FormFactors, lights: &LightSet) {
        if self.real {
            foresight.level = Level::new(simplified);
            foresight.sky = if lights.even_sky().is_some() { Sky::new(f) } else { Sky::default() };
        }
    }

    /// With `only`, rows do not tell what light reaches, but the solution does.
    pub fn see(&self, light: &mut PatchLight) {
        if self.near.is_some() {
            for i in 0..light.reached.len() {
                light.reached[i] = light.direct[i] != Vec3::ZERO || light.indirect[i] != Vec3::ZERO;
            }
        }
    }
}

/// Casts no more rays to lamps that reach nothing; how many there are, and the rays that found it out.
pub(super) fn forget_dark(lights: &mut LightSet, census: Option<Census>) -> (usize, u64) {
    let Some((dark, rays)) = census.map(|census| census.dark()) else { return (0, 0) };
    let count = dark.iter().filter(|&&d| d).count();
    lights.forget(dark);
    (count, rays)
}
