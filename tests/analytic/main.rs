//! Whole bakes against closed forms. Run with `--nocapture` to see the errors.

#[path = "../common/mod.rs"]
mod common;

mod cie;
mod form_factors;
mod furnace;
mod sphere;

/// Runs cases of `luxel selftest` on the default ray tracer.
fn passes(group: &str) {
    use luxel::selftest::{GROUPS, Verdict};
    let group = GROUPS.iter().find(|g| g.name == group).expect("a group of the self-test");
    let rows = (group.run)(luxel::options::Backend::Auto).expect("a result");
    rows.iter().for_each(|row| println!("{row}"));
    let failed: Vec<_> = rows.iter().filter(|row| row.verdict == Verdict::Fail).collect();
    assert!(!rows.is_empty() && failed.is_empty(), "{failed:#?}");
}
