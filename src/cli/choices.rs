//! The values of options that are a choice, as the command line and the library name them.

use clap::ValueEnum;
use luxel::{
    Quality,
    options::{Backend, FaceColour, PatchSource, Primary, Reconstruct},
    scene::SidesRule,
};

/// Declares the values of an option and what they stand for.
macro_rules! choice {
    ($name:ident for $target:ty { $($(#[$doc:meta])* $value:ident),+ $(,)? }) => {
        #[derive(Clone, Copy, Debug, ValueEnum)]
        pub enum $name { $($(#[$doc])* $value),+ }

        impl From<$name> for $target {
            fn from(choice: $name) -> $target {
                match choice { $($name::$value => <$target>::$value),+ }
            }
        }
    };
}

choice!(Preset for Quality {
    /// A quick look: grid 32, 128 rays
    Preview,
    /// Grid 64, 256 rays
    Default,
    /// Grid 96, 1024 rays, adaptive reconstruction
    High,
});
choice!(Patches for PatchSource {
    /// Pieces of the real surfaces, grouped by voxel and direction
    Surfels,
    /// The paper's method: equal square faces of the voxels
    Faces,
    /// Triangles of the mesh, simplified by edge collapse
    Decimated,
    /// Triangles of the mesh, simplified by vertex clustering
    Clustered,
    /// Triangles of a hand-made simplified mesh, see `--proxy`
    Proxy,
});
choice!(Interpolation for Reconstruct {
    /// Local linear least squares over visible patches
    Smooth,
    /// The paper's four nearest patches by inverse distance
    Nearest4,
    /// Final gather: rays of every point ask the patches that it sees
    Gather,
    /// Smooth, and gather where the patches nearby do not agree on the light
    Adaptive,
});
choice!(PrimaryLight for Primary {
    /// Sampled at patches and vertices
    Direct,
    /// Emitting surfaces are patches of the radiosity system
    Radiosity,
});
choice!(Tracer for Backend {
    /// Embree where it is compiled in, else bvh
    Auto,
    /// Intel Embree
    Embree,
    /// Pure Rust (obvhs)
    Bvh,
    /// Every triangle against every ray: exact, slow
    Brute,
});
choice!(Colour for FaceColour {
    /// Mean, weighted by projected area
    Normalised,
    /// The literal sum of colour times projected area over face area
    Literal,
});
choice!(Sides for SidesRule {
    /// Closed solids and rooms one side, open sheets two
    Auto,
    /// The side that the winding says
    One,
    /// Both
    Two,
});
