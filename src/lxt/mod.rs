//! Transfer files: what a bake needs and no light changes. The bytes are explained in docs/LXT.md.

mod build_id;
mod container;
mod layout;
pub(crate) mod map;
pub(crate) mod raw;
pub mod simplified;
pub mod source;
mod write;

pub use build_id::BuildId;
pub use container::Container;
pub use layout::{FORMAT, Name};
pub use write::{Writer, write_file};
