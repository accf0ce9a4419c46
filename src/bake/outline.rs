//! What the rows of a bake have in common that are cast by several processes.

use serde::{Deserialize, Serialize};

use super::{Kept, Run, check, measure::Clock, outlook, prepared::Prepared};
use crate::{BakeOptions, Result, Scene, outlook::Outlook, transfer};

/// How the rows of [`prepare`](super::prepare) are cast, besides patches and options. Lists are by patch; empty ones hold
/// for no patch.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Outline {
    /// Patches that no surface lies before.
    pub outer: Vec<bool>,
    /// Patches whose rows have fewer rays.
    pub few: Vec<bool>,
    /// Patches whose rows are there already, or that need none.
    pub spared: Vec<bool>,
}

/// Does the part of [`prepare`](super::prepare) that cannot be shared out: makes the patches, and with
/// [`BakeOptions::only`] casts the rows of those that tell what matters. Puts both into `kept`.
///
/// The rows that are left are of a few more patches than `prepare` would cast with `only`, since only their rows would
/// tell which of them matter. Given all of them, `prepare` casts no ray, and keeps what it would without them.
///
/// # Errors
/// Those of [`prepare`](super::prepare).
pub fn outline(scene: &Scene, options: &BakeOptions, kept: &mut Kept, run: &mut Run) -> Result<Outline> {
    check(scene, options)?;
    kept.marked = true;
    let mut clock = Clock::new(run.deadline, run.progress);
    let prepared = Prepared::new(scene, options, kept, &mut clock)?;
    let needs = &prepared.needs;
    let (mut few, mut spared) = (Vec::new(), Vec::new());
    if let Some([_, near]) = &needs.near {
        let plan = needs.plan(near);
        let casting = prepared.casting(true);
        let own: Vec<u32> = (0..).zip(near).filter(|(_, near)| **near).map(|(i, _)| i).collect();
        run.keeper.begin(&mut kept.rows, &|| outlook::of_rows(&casting, &own, run.progress))?;
        few = transfer::first_wave(&casting, &plan, &mut kept.rows, run.keeper, run.progress)?;
        spared = near.iter().zip(plan.black).map(|(near, black)| near | black).collect();
    } else {
        run.keeper.begin(&mut kept.rows, &|| Ok(Outlook::of_rows(0.0)))?;
    }
    let outer = needs.outer.clone();
    kept.simplified = Some(prepared.simplified);
    Ok(Outline { outer, few, spared })
}
