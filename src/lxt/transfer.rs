//! Transfer files: a scene and all that a bake of it needs, whatever its lights and colours will be.

use std::{
    fs,
    io::{self, Write},
    path::Path,
};

use super::{
    Container, Identity, Name, Writer,
    rows::{self, AGAIN, Entries, ROWS},
    simplified, source, stencils, write_file,
};
use crate::{
    BakeOptions, Error, Result, Scene,
    bake::{AGAIN_A_BLOCK, Kept, ROWS_A_BLOCK},
    output::atomic::Staged,
    scene::{SceneOverrides, Source},
};

const IDENTITY: Name = Name::new("identity");
const OPTIONS: Name = Name::new("options");

/// An open transfer file.
pub struct Transfer {
    file: Container,
    identity: Identity,
    options: BakeOptions,
    source: Source,
}

impl Transfer {
    /// What its container is for.
    pub const PURPOSE: Name = Name::new("transfer");

    /// Writes the file `path`: `scene` is built of `source`, and `kept` is what [`prepare`](crate::bake::prepare) made of
    /// it with `options`.
    ///
    /// # Errors
    /// [`Error::Io`] with the path; what was there before stays.
    pub fn write(path: &Path, source: &Source, scene: &Scene, options: &BakeOptions, kept: &Kept) -> Result<()> {
        let identity = Identity::new(scene, options)?;
        write_file(path, Transfer::PURPOSE, |out| Transfer::fill(out, &identity, source, options, kept))
    }

    /// Writes the blocks of a file into a container for [`Transfer::PURPOSE`]; `identity` is that of the scene.
    ///
    /// # Errors
    /// Those of the output.
    pub fn fill<W: Write>(
        out: &mut Writer<W>,
        identity: &Identity,
        source: &Source,
        options: &BakeOptions,
        kept: &Kept,
    ) -> io::Result<()> {
        out.json(IDENTITY, 0, identity)?;
        out.value(OPTIONS, 0, options)?;
        source::write(out, source)?;
        if let Some(simplified) = &kept.simplified {
            simplified::write(out, simplified, options)?;
        }
        Transfer::fill_rest(out, kept)
    }

    /// Writes the blocks behind those of the patches.
    fn fill_rest<W: Write>(out: &mut Writer<W>, kept: &Kept) -> io::Result<()> {
        if let Some(stencils) = &kept.stencils {
            stencils::write(out, stencils)?;
        }
        rows::write_in_order(out, ROWS, &kept.rows, ROWS_A_BLOCK)?;
        rows::write_in_order(out, AGAIN, &kept.again, AGAIN_A_BLOCK)
    }

    /// As [`Transfer::write`], of what does not go with `kept` a copy of the blocks of `file`, which has them for its own
    /// purpose. Patches are pieces of the surfaces.
    ///
    /// # Errors
    /// Those of [`Transfer::write`] and [`Container::block`].
    pub fn copy(path: &Path, file: &Container, kept: &Kept) -> Result<()> {
        let kinds = [IDENTITY, OPTIONS, source::SCENE].into_iter().chain(simplified::COMMON);
        let names = kinds.flat_map(|kind| file.numbers(kind).map(move |number| (kind, number)));
        let block = |(kind, number)| Ok((kind, number, file.block_with_hash(kind, number)?));
        let blocks = names.map(block).collect::<Result<Vec<_>>>()?;
        write_file(path, Transfer::PURPOSE, |out| {
            blocks.iter().try_for_each(|(kind, number, (payload, hash))| out.copy(*kind, *number, payload, *hash))?;
            Transfer::fill_rest(out, kept)
        })
    }

    /// Makes sure that a transfer file can be written at `path`: its folder is made if it is missing, and the place is this
    /// process's alone as long as what is returned lives; `work` says what for. Nothing is overwritten but a transfer file, of
    /// whatever version.
    ///
    /// # Errors
    /// Those of [`Staged::open_file`]; [`Error::Option`] if there is another file.
    pub fn claim(path: &Path, work: &str) -> Result<Staged> {
        let staged = Staged::open_file(path, work)?;
        let is_other = match fs::metadata(path) {
            Ok(there) => there.len() > 0 && Container::purpose(path)? != Some(Transfer::PURPOSE),
            Err(_) => false,
        };
        if is_other {
            let problem = "is there already, and is no transfer file; choose another name, or remove it";
            return Err(Error::Option(format!("{}: {problem}", path.display())));
        }
        Ok(staged)
    }

    /// Opens a file, and compares all of it with its checksums.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Input`]: see [`Container::open`]; also if another build made the file.
    pub fn open(path: &Path) -> Result<Transfer> {
        Transfer::of(Container::open(path, Transfer::PURPOSE)?)
    }

    /// As [`Transfer::open`], of an open container.
    ///
    /// # Errors
    /// As of [`Transfer::open`].
    pub fn of(file: Container) -> Result<Transfer> {
        let identity: Identity = file.json(IDENTITY, 0)?;
        identity.check_build(file.path())?;
        file.verify()?;
        let options = file.value(OPTIONS, 0)?;
        let source = source::read(&file)?;
        Ok(Transfer { file, identity, options, source })
    }

    /// The settings that the file was made with.
    pub fn options(&self) -> &BakeOptions {
        &self.options
    }

    /// The scene with the lights and colours of `overrides` besides its own lights, or instead of those that are not
    /// surfaces.
    ///
    /// # Errors
    /// Those of [`Source::change`] and [`Source::build`]; [`Error::Scene`] if the lights change more than light: a lamp in
    /// a closed solid makes a room of it.
    pub fn scene(&self, overrides: &SceneOverrides, instead: bool) -> Result<Scene> {
        let mut source = self.source.clone();
        if instead {
            source.remove_lights();
        }
        source.change(overrides)?;
        let scene = source.build()?;
        if Identity::surfaces(&scene) != self.identity.surfaces {
            return Err(Error::Scene(format!(
                "with these lights the surfaces of \"{}\" have other sides than those that were prepared: prepare the \
                 scene with these lights, or with --sides one or two, which do not depend on lights",
                scene.name
            )));
        }
        Ok(scene)
    }

    /// What the file holds for `scene`, which [`Transfer::scene`] made.
    ///
    /// # Errors
    /// [`Error::Input`] naming the block that is wrong.
    pub fn kept(&self, scene: &Scene) -> Result<Kept> {
        let simplified = simplified::read(&self.file, scene, &self.options)?;
        let patches = simplified.patches.len();
        Ok(Kept {
            rows: rows::read_all(&self.file, ROWS, patches, Entries::Checked)?,
            again: rows::read_all(&self.file, AGAIN, patches, Entries::Checked)?,
            stencils: Some(stencils::read(&self.file, patches)?),
            simplified: Some(simplified),
            marked: true,
        })
    }
}
