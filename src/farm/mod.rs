//! A bake shared out among processes that have nothing but a folder in common.
//!
//! [`Plan::make`] makes the patches, and divides the work of [`prepare`](crate::bake::prepare) into shards: rows of
//! successive patches, which foreseeably take equally long. [`Plan::cast`] casts the rows of one, on any machine with the
//! same build, in any order. [`Plan::merge`] puts them together. As a row depends on the patches, the settings and its
//! number alone, how the work was divided makes no difference to the result.
//!
//! Where vertices are depends on which patches are hidden, which rows tell at last. A few rays of each patch foretell it, so
//! that the plan can make the vertices and each shard the stencils of its part of them; if the rows tell otherwise, they are
//! made when the shards are merged.
//!
//! The folder of a plan:
//!
//! | file | |
//! |-|-|
//! | `plan.lxt` | the scene, the patches, the vertices, the settings, the shards |
//! | `shard-K.lxt` | the rows and stencils of shard K, whole or not there |
//! | `shard-K.checkpoint` | rows of shard K while it is cast |
//! | `.shard-K.lock` | who casts it |
//! | `array.sbatch`, `merge.sbatch`, `logs/` | jobs of Slurm, and what they say ([`submit`]) |
//!
//! The first two are [containers](crate::lxt::Container), the third is a [checkpoint](crate::lxt::Checkpoint).

mod balance;
mod folder;
mod merge;
mod plan;
mod shard;
mod slurm;
mod status;
pub mod submit;

pub use balance::{Division, Part};
pub use plan::Plan;
pub use shard::Cast;
pub use status::{ShardState, ShardStatus};
