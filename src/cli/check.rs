//! `luxel check`.

use luxel::Result;

use super::{BakeArgs, load, say};

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    bake: BakeArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let (scene, _options) = load(&args.bake)?;
    say(&format!("{}: {} triangles\n", scene.name, scene.triangles.len()));
    Ok(())
}
