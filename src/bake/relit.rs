//! A bake whose lights have changed.

use glam::Vec3;

use super::{Bake, PatchLight};
use crate::{
    light::LightSet,
    reconstruct::Factors,
    skip::Sky,
    transfer::{FormFactors, Rows},
};

/// Light that a bake is to have instead of its own; of patches, W/m2.
pub(crate) struct RelitLight {
    pub lights: LightSet,
    /// As [`Bake`] has them, and so `smooth` and `carried`.
    pub bright: Option<LightSet>,
    pub direct: Vec<Vec3>,
    pub indirect: Vec<Vec3>,
    pub smooth: Vec<Vec3>,
    pub radiosity: Vec<Vec3>,
    pub carried: Vec<Vec3>,
}

impl Bake {
    /// What the vertices take from the patches, once for all light; bakes that gather interpolate by least squares.
    pub(crate) fn factors(&self) -> Factors {
        Factors::new(&self.field(&[], &[]), self.options.reconstruct, &self.mesh.samples)
    }

    /// Takes the rows of all patches, where the bake had those alone that its lights reach.
    pub(crate) fn take_rows(&mut self, rows: &Rows) {
        let all = vec![true; rows.patches()];
        self.form_factors = FormFactors::of_rows(rows, &all, &self.light.reached);
        self.light.known = rows.visible();
    }

    /// Takes other lights and the light of the patches that goes with them. `reached` and `known` stay as they are, and so do
    /// the vertices.
    pub(crate) fn relight(&mut self, light: RelitLight) {
        let RelitLight { lights, bright, direct, indirect, smooth, radiosity, carried } = light;
        if lights.even_sky().is_none() {
            // A few rays say nothing of a sky with bright spots.
            self.foresight.sky = Sky::default();
        }
        (self.lights, self.bright) = (lights, bright);
        (self.glow, self.error, self.report.error) = (None, None, None);
        (self.smooth, self.carried) = (smooth, carried);
        let PatchLight { reached, known, .. } = std::mem::take(&mut self.light);
        self.light = PatchLight { direct, indirect, radiosity, reached, known };
    }
}
