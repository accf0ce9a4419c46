//! Form factors between patches, by Monte-Carlo ray casting (step 6 of the paper).

mod cast;
mod emit;
mod estimate;
mod lanes;
mod matrix;
mod points;
mod rows;
mod spill;
mod tally;

pub use cast::{Casting, TIMED, cast, receive, row_length, row_rays, seconds_a_ray};
pub use emit::{Emitter, patch_points};
pub use estimate::{Estimate, Plan, estimate, estimate_plan, first_wave};
pub use matrix::FormFactors;
pub use points::PointSets;
pub use rows::{Block, BlockWriter, Coded, Row, RowKeeper, RowRef, Rows, View};
pub use spill::Spill;
