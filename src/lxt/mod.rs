//! Transfer files: what a bake needs and no light changes. The bytes are explained in docs/LXT.md.

mod container;
mod layout;
pub mod map;
mod write;

pub use container::Container;
pub use layout::{FORMAT, Name};
pub use write::{Writer, write_file};
