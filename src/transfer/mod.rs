//! Form factors between patches, by Monte-Carlo ray casting (step 6 of the paper).

mod emit;
mod estimate;
mod lanes;
mod matrix;
mod points;
mod tally;

pub use emit::{Emitter, patch_points};
pub use estimate::{Estimate, Plan, estimate, estimate_plan, receive_again, row_rays};
pub use matrix::{FormFactors, Row};
pub use points::PointSets;
