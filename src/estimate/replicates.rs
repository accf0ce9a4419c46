//! Replicates of rows: those of some patches, cast once more with rays of their own. What a patch receives by the one and by the
//! other differs by noise alone.

use super::chosen;
use crate::{
    Result,
    bake::{Bake, Kept},
    progress::{Hushed, Progress},
    transfer::{self, Casting, RowKeeper, RowPoints, Rows},
};

/// Share of the rows that have a replicate.
const SHARE: f64 = 1.0 / 16.0;
/// Rows that have one at least, where there are as many.
const LEAST: usize = 512;
/// Purpose word of random bits.
const CHOICE: u64 = 0x726f_7773;

/// Patches, of so many, whose rows have replicates.
pub(crate) fn replicated(patches: usize, seed: u64) -> Vec<u32> {
    chosen(patches, SHARE, LEAST, seed ^ CHOICE)
}

/// Casts those replicates of the rows of `patches` that `rows` does not have; how many rays that took. `casting` is that of the
/// rows themselves.
///
/// # Errors
/// Those of [`transfer::cast`].
pub(crate) fn replicate(
    casting: &Casting,
    patches: &[u32],
    rows: &mut Rows,
    keeper: &mut dyn RowKeeper,
    progress: &dyn Progress,
) -> Result<u64> {
    transfer::cast(&Casting { again: 1, marked: false, ..*casting }, patches, &[], rows, keeper, progress)
}

/// Those of the rows of a bake.
pub(super) struct Replicates<'a> {
    casting: Casting<'a>,
    /// The patches, those that have rows.
    pub patches: Vec<u32>,
    /// Those that are kept.
    rows: &'a Rows,
}

impl<'a> Replicates<'a> {
    /// Where rows are kept for bakes with other lights, these find their replicates there too from now on.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted).
    pub fn new(
        bake: &'a Bake,
        points: &'a RowPoints,
        kept: &'a mut Kept,
        progress: &dyn Progress,
    ) -> Result<Replicates<'a>> {
        let has_row = |i: &u32| bake.form_factors.has_row(*i as usize);
        let patches: Vec<u32> =
            replicated(bake.patches().len(), bake.options.seed).into_iter().filter(has_row).collect();
        let casting = Casting { again: 1, ..Casting::new(&bake.simplified, bake.patch_tracer(), &[], points) };
        if kept.marked {
            replicate(&casting, &patches, &mut kept.again, &mut (), &Hushed(progress))?;
        }
        Ok(Replicates { casting, patches, rows: &kept.again })
    }

    /// What they receive where patches have sent so much, in the order of the patches; those that are not kept are cast.
    pub fn receive(&self, sent: &[f32], closed: bool) -> Vec<f64> {
        transfer::receive(&self.casting, &self.patches, sent, closed, self.rows)
    }
}
