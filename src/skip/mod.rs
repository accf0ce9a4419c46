//! What a scene does not need: how it is found, and the list of what was left out.
//!
//! | what | found by | costs |
//! |-|-|-|
//! | rows and probes of outer shells, shadow rays from them | [`Outer`]: no vertex lies before the surface | nothing |
//! | rows of patches that no light reaches | probe rays ([`crate::transfer::estimate`]) | bounded by the probes |
//! | shadow rays to lamps behind, to black skies | the formulas of the lamps | nothing |
//! | shadow rays to lamps that reach nothing | [`crate::light::Census`] | bounded by the rays cast |
//! | sky rays of points that see no sky, or only sky | [`Sky`]: the rows of the patches around | bounded by those rays |
//! | visibility rays along planes | [`crate::reconstruct::Level`] | nothing |
//! | equal channels | [`solve`] | nothing |
//! | textures of one colour | [`plain`] | rounding |
//! | what does not matter to the meshes that are wanted | [`Wanted`] | measured |

mod audit;
mod bands;
mod foresight;
mod only;
mod outer;
mod sky;
mod textures;

pub use audit::{Audit, Unwanted, list};
pub use bands::solve;
pub use foresight::Foresight;
pub use only::{Wanted, noise};
pub use outer::Outer;
pub use sky::Sky;
pub use textures::plain;
