//! luxel bakes diffuse global illumination on the CPU.
//!
//! It solves the radiosity equation `B = M + rho F B` on a simplified copy of the scene (equal voxels cut the
//! surfaces into patches), with form factors `F` by Monte-Carlo ray casting, and carries the result back to the
//! vertices of the original surfaces. Method: Shcherbakov & Frolov, "Automatic geometry simplification for
//! secondary illumination by radiosity"; see ARCHITECTURE.md for what differs and why.
//!
//! The pipeline, in order: scene -> simplify -> transfer -> light -> solve -> reconstruct
//! -> output. [`bake()`] runs it whole; `examples/in_memory.rs` calls the stages one by one.
//!
//! Light is linear RGB, three independent bands: emission is radiance (W/m2/sr), results are irradiance (W/m2).
//! Geometry inside is in the [local frame](scene::Frame) of the scene.
//!
//! A cube of 2 m with a point light of 10 W in its middle. In a closed room of area S and one albedo rho, whatever
//! its shape, the mean of the indirect irradiance is exactly power / S * rho / (1 - rho), and all power is absorbed:
//!
//! ```
//! use glam::{DVec3, Vec3};
//! use luxel::{BakeOptions, options::Resolution, progress::Silent, scene::*};
//!
//! let mut builder = Builder::new("cube");
//! let surface = Material { name: "grey".into(), albedo: Vec3::splat(0.5), ..Material::default() };
//! let grey = builder.add_material(RawMaterial { surface, ..RawMaterial::default() });
//! builder.add_mesh(RawMesh {
//!     name: "cube".into(),
//!     // Corner number x + 2 y + 4 z.
//!     positions: (0..8).map(|i| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 2.0).collect(),
//!     // It holds a light, so it is a room, whichever way it is wound.
//!     triangles: [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
//!         .iter()
//!         .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
//!         .collect(),
//!     material: grey,
//!     ..RawMesh::default()
//! });
//! let intensity = Vec3::splat(10.0 / (4.0 * std::f32::consts::PI));
//! builder.add_light(WorldLight::Point { position: DVec3::ONE, intensity, range: f64::INFINITY });
//! let scene = builder.build(SidesRule::Auto)?;
//!
//! let options = BakeOptions { resolution: Resolution::Grid(16), ..BakeOptions::default() };
//! let bake = luxel::bake(&scene, &options, &Silent)?;
//!
//! // Tolerances are four standard errors of as many random points and rays (here: Sobol): 5 % spread of direct light
//! // in a patch, 55,000 points; 40 % spread of radiosity, 440,000 rays, 1 / (1 - rho) = 2 times over.
//! let energy = &bake.report.energy;
//! assert!((energy.direct[0] / 10.0 - 1.0).abs() < 0.001);
//! assert!((energy.absorbed[0] / 10.0 - 1.0).abs() < 0.005);
//!
//! let (areas, indirect) = (&bake.patches().area, &bake.light.indirect);
//! let mean = areas.iter().zip(indirect).map(|(a, e)| a * e.x).sum::<f32>() / areas.iter().sum::<f32>();
//! assert!((mean / (10.0 / 24.0) - 1.0).abs() < 0.005);
//! # luxel::Result::Ok(())
//! ```
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod colour;
pub mod error;
pub mod lock;
pub mod options;
pub mod outlook;
pub mod progress;
pub mod quality;
pub mod report;
pub mod sampling;

pub mod light;
pub mod reconstruct;
pub mod scene;
pub mod simplify;
pub mod skip;
pub mod solve;
pub mod trace;
pub mod transfer;

pub mod bake;
pub mod bench;
pub mod compare;
pub mod estimate;
pub mod farm;
pub mod forecast;
pub mod goal;
pub mod lxt;
pub mod output;
pub mod reference;
pub mod relight;
pub mod selftest;

pub use bake::bake;
pub use error::{Error, Result};
pub use forecast::forecast;
pub use goal::{Goal, bake_to};
pub use options::BakeOptions;
pub use quality::Quality;
pub use relight::Relighter;
pub use scene::Scene;

/// The README's code compiles.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
