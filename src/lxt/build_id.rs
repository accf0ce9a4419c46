//! Which build of luxel, on which machine: whatever changes a bit of the result.

use std::{fmt, sync::LazyLock};

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::{
    Result,
    options::Backend,
    trace::{self, Geometry, RayTracer},
};

/// What two processes must have in common for their parts of one bake to fit together to the bit.
///
/// Ray tracers round differently on different instruction sets, and mathematical functions differently in different C
/// libraries, or in one on different processors.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(default)]
pub struct BuildId {
    /// Version of luxel.
    pub version: String,
    /// Hash of its source and of the versions of its dependencies.
    pub source: String,
    /// Version of the compiler.
    pub compiler: String,
    /// What it was compiled for, e.g. `x86_64-unknown-linux-gnu`.
    pub target: String,
    /// Name and version of the ray tracer.
    pub tracer: String,
    /// The instructions that the ray tracer runs on.
    pub instruction_set: String,
    /// Hash of some thousand values of the mathematical functions of the machine.
    pub mathematics: String,
}

impl BuildId {
    /// This process, with the ray tracer that it uses.
    pub fn new(tracer: &dyn RayTracer) -> BuildId {
        BuildId {
            version: env!("CARGO_PKG_VERSION").into(),
            source: env!("LUXEL_SOURCE").into(),
            compiler: env!("LUXEL_COMPILER").into(),
            target: env!("LUXEL_TARGET").into(),
            tracer: tracer.name(),
            instruction_set: tracer.instruction_set(),
            mathematics: MATHEMATICS.clone(),
        }
    }

    /// This process, with the ray tracer that `backend` asks for.
    ///
    /// # Errors
    /// Those of [`trace::build`].
    pub fn of(backend: Backend) -> Result<BuildId> {
        let triangle = Geometry { positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y], triangles: vec![[0, 1, 2]] };
        Ok(BuildId::new(&*trace::build(backend, &triangle)?))
    }

    /// Names what differs, e.g. `instruction set AVX-512 there, AVX2 here`; `None` if nothing does.
    pub fn difference(&self, here: &BuildId) -> Option<String> {
        let pairs = [
            ("luxel", &self.version, &here.version),
            ("source", &self.source, &here.source),
            ("compiler", &self.compiler, &here.compiler),
            ("target", &self.target, &here.target),
            ("ray tracer", &self.tracer, &here.tracer),
            ("instruction set", &self.instruction_set, &here.instruction_set),
            ("mathematical functions", &self.mathematics, &here.mathematics),
        ];
        let differences: Vec<String> = (pairs.into_iter().filter(|(_, there, here)| there != here))
            .map(|(what, there, here)| format!("{what} {there} there, {here} here"))
            .collect();
        (!differences.is_empty()).then(|| differences.join("; "))
    }
}

/// `luxel 0.1.0 (source 1234), rustc 1.90.0, embree 3.13.5, 8-wide, AVX2`.
impl fmt::Display for BuildId {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let BuildId { version, source, compiler, target, tracer, instruction_set, mathematics: _ } = self;
        write!(f, "luxel {version} (source {source}), {compiler}, {target}, {tracer}, {instruction_set}")
    }
}

static MATHEMATICS: LazyLock<String> = LazyLock::new(|| {
    let mut hasher = blake3::Hasher::new();
    for i in 0..256 {
        // From 0.01 to 100.
        let x = 1e-2 * 1e4_f64.powf(i as f64 / 255.0);
        let y = x as f32;
        let (sin, cos) = x.sin_cos();
        let (sin32, cos32) = y.sin_cos();
        let wide = [sin, cos, x.tan(), x.atan(), x.atan2(1.5), x.ln(), x.log2(), x.log10(), x.cbrt(), (-x).exp()];
        let more = [x.powf(2.4), x.hypot(0.7), sin.acos(), x.exp2(), x.sin(), x.cos()];
        let narrow = [sin32, cos32, y.tan(), y.atan(), y.atan2(1.5), y.ln(), y.log2(), y.log10(), y.cbrt(), (-y).exp()];
        let few = [y.powf(2.4), y.hypot(0.7), sin32.acos(), y.exp2(), y.sin(), y.cos()];
        for values in [&wide[..], &more] {
            hasher.update(bytemuck::cast_slice(values));
        }
        for values in [&narrow[..], &few] {
            hasher.update(bytemuck::cast_slice(values));
        }
    }
    hasher.finalize().to_hex()[..16].into()
});

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::Brute;

    #[test]
    fn the_same_build_has_no_difference_and_others_are_named() {
        let here = BuildId::new(&Brute::new(&Geometry::default()));
        assert_eq!(here.difference(&here.clone()), None);
        assert!(here.compiler.starts_with("rustc 1."), "{}", here.compiler);
        assert!(here.source.len() == 16 && here.target.contains('-'), "{here}");
        let there = BuildId { tracer: "embree 4".into(), instruction_set: "AVX-512".into(), ..here.clone() };
        let expected = format!(
            "ray tracer embree 4 there, {} here; instruction set AVX-512 there, {} here",
            here.tracer, here.instruction_set
        );
        assert_eq!(there.difference(&here).unwrap(), expected);
    }
}
