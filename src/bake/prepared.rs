//! What a bake needs and lights do not change.

use std::borrow::Cow;

use super::{
    Sight,
    measure::Clock,
    needs::Needs,
    outlook::{Coming, Purpose},
    tracers::Tracers,
    vertices,
};
use crate::{
    BakeOptions, Result, Scene, estimate, forecast,
    options::PatchSource,
    outlook::Limit,
    output::report::memory_bytes,
    progress::Progress,
    reconstruct::{PatchIndex, Stencils},
    scene::SurfacePoint,
    simplify::{self, Grid, Simplified},
    skip::{self, Foresight, Wanted},
    trace,
    transfer::{self, Casting, RowKeeper, RowPoints, Rows},
};

/// Results of earlier work on the same surfaces with the same settings, whatever its lights and colours were. A bake
/// takes from it what is there, and adds the rows that it casts; which of them were there makes no difference to its
/// result.
#[derive(Default)]
pub struct Kept {
    /// Patches; colours are those of the scene that is baked.
    pub simplified: Option<Simplified>,
    /// Rows. None of any patch are there by default.
    pub rows: Rows,
    /// Rows of other rays, which tell how noisy the first are.
    pub again: Rows,
    /// Which patches vertices take their light from.
    pub stencils: Option<Stencils>,
    /// Whether rows are cast for other lights too: they then get marks of what their leading rays met.
    pub marked: bool,
}

/// Successive patches whose rows make a block of what is prepared, and whose rows of other rays do: one in 16 patches
/// or more has these.
pub(crate) const ROWS_A_BLOCK: usize = 64;
pub(crate) const AGAIN_A_BLOCK: usize = 1024;

/// A scene that is ready to be lit.
pub(super) struct Prepared<'a> {
    pub scene: Cow<'a, Scene>,
    /// Materials with textures of one colour.
    pub plain: Vec<u32>,
    pub only: Option<Wanted>,
    pub tracers: Tracers,
    /// Where the rays of rows start and go.
    pub points: RowPoints,
    pub foresight: Foresight,
    pub simplified: Simplified,
    pub index: PatchIndex,
    pub needs: Needs,
    /// Bytes that the process held before it made the patches.
    pub before: u64,
}

impl<'a> Prepared<'a> {
    /// Of `scene`, if that takes no more memory than `limit`.
    pub fn new(
        scene: &'a Scene,
        options: &BakeOptions,
        kept: &mut Kept,
        limit: Option<Limit>,
        clock: &mut Clock,
    ) -> Result<Prepared<'a>> {
        let only = Wanted::new(scene, &options.only)?;
        let (scene, plain) = if options.skip { skip::plain(scene) } else { (Cow::Borrowed(scene), Vec::new()) };
        let grid = Grid::new(&scene, options.resolution)?;
        // Patches that are kept are in the memory already.
        if let Some(limit) = limit.filter(|_| kept.simplified.is_none()) {
            forecast::check_limit(&scene, options, &grid, limit)?;
        }
        simplify::check_size(&scene, &grid, forecast::FRAGMENT_BYTES)?;
        let geometry = scene.geometry();
        let tracer = trace::build(options.backend, &geometry)?;
        let foresight = Foresight::new(options.skip, &geometry);
        clock.stop("build")?;

        let before = memory_bytes();
        let simplified = match kept.simplified.take() {
            Some(simplified) => simplify::coloured(simplified, &scene, options, &*tracer)?,
            None => simplify::simplify(&scene, grid, options, &*tracer)?,
        };
        let own = options.patches != PatchSource::Surfels;
        let faces = own.then(|| trace::build(options.backend, &simplified.geometry)).transpose()?;
        let tracers = Tracers { surfaces: tracer, faces };
        let points = RowPoints::new(options.rays, options.seed, tracers.patches());
        for rows in [&mut kept.rows, &mut kept.again] {
            if rows.patches() != simplified.patches.len() {
                *rows = Rows::new(simplified.patches.len());
            }
        }
        let index = PatchIndex::new(&simplified.patches, grid);
        let needs = Needs::new(&scene, &simplified, &index, options, only.as_ref(), &foresight);
        clock.stop("simplify")?;
        Ok(Prepared { scene, plain, only, tracers, points, foresight, simplified, index, needs, before })
    }

    /// Which patches the vertices of all visible surfaces take their light from.
    pub fn stencils(&self, options: &BakeOptions, rows: &Rows) -> Stencils {
        let known = rows.visible();
        let points = self.points_of_vertices(options, &known);
        let (tracer, normals) = (self.tracers.surfaces(), self.scene.normals());
        let mut sight = Sight::new(self, known, options);
        let level = sight.take_level(self.simplified.grid.voxel_size);
        Stencils::new(&sight.field(&self.simplified, &self.index, tracer, &normals, &level, options), &points)
    }

    /// Where the light of the vertices of all visible surfaces is computed, if these patches are `known`.
    pub fn points_of_vertices(&self, options: &BakeOptions, known: &[bool]) -> Vec<SurfacePoint> {
        let (only, tracer) = (self.only.as_ref(), self.tracers.surfaces());
        vertices::mesh(&self.scene, &self.simplified, known, &self.index, options, only, tracer).samples
    }

    /// How rows are cast.
    pub fn casting(&self, marked: bool) -> Casting<'_> {
        self.needs.casting(&self.simplified, self.tracers.patches(), &self.points, marked)
    }

    /// Casts the rows that any lights may need, and those that tell of their noise; how many rays that took.
    pub fn cast(
        &self,
        options: &BakeOptions,
        kept: &mut Kept,
        keeper: &mut dyn RowKeeper,
        progress: &dyn Progress,
    ) -> Result<u64> {
        let casting = self.casting(true);
        let all = vec![true; self.simplified.patches.len()];
        // What matters to the wanted meshes does not depend on lights.
        let plan = self.needs.plan(&all);
        let replicated = if options.estimate { estimate::replicated(all.len(), options.seed) } else { Vec::new() };
        let purpose = Purpose::Transfer { replicates: replicated.len() };
        let coming = Coming { scene: &self.scene, casting: &casting, plan, purpose, before: self.before };
        coming.begin(&mut kept.rows, options, keeper, progress)?;
        let mut rays = match &self.needs.near {
            Some(_) => {
                let estimate = transfer::estimate_plan(&casting, &plan, &mut kept.rows, keeper, progress)?;
                kept.rows = kept.rows.in_order(ROWS_A_BLOCK, |i| estimate.reached[i as usize]);
                estimate.rays
            }
            None => {
                let all: Vec<u32> = (0..self.simplified.patches.len() as u32).collect();
                transfer::cast(&casting, &all, &[], &mut kept.rows, keeper, progress)?
            }
        };
        rays += estimate::replicate(&casting, &replicated, &mut kept.again, keeper, progress)?;
        Ok(rays)
    }
}
