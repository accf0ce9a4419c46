//! Transfer files: what a bake needs and no light changes. The bytes are explained in docs/LXT.md.

mod array;
mod build_id;
mod cache;
mod checkpoint;
mod container;
mod identity;
mod layout;
mod log;
pub(crate) mod map;
pub mod points;
pub(crate) mod raw;
pub mod rows;
pub mod simplified;
pub mod source;
pub mod stencils;
mod transfer;
mod write;

pub use array::Array;
pub use build_id::BuildId;
pub use cache::Cache;
pub use checkpoint::Checkpoint;
pub use container::Container;
pub use identity::Identity;
pub use layout::{FORMAT, Name};
pub use transfer::Transfer;
pub use write::{Writer, write_file};
