//! Form factors between patches, by Monte-Carlo ray casting (step 6 of the paper).

mod block;
mod cast;
mod caster;
mod coding;
mod emit;
mod estimate;
mod lanes;
mod matrix;
mod points;
mod rows;
mod sorted;
mod spill;
mod tally;

pub use block::{Block, BlockWriter, Coded, Row, RowRef, View};
pub use cast::{Casting, cast, foresee_visible, receive, row_length, seconds_of_rows};
pub use caster::row_rays;
pub use emit::{Emitter, patch_points};
pub use estimate::{Estimate, Plan, estimate, estimate_plan, first_wave};
pub use matrix::FormFactors;
pub use points::{PointSets, RowPoints};
pub use rows::{RowKeeper, Rows};
pub use spill::Spill;
