//! Whole bakes against closed forms. Run with `--nocapture` to see the errors.

#[path = "../common/mod.rs"]
mod common;

mod cie;
mod form_factors;
mod furnace;
mod sphere;
