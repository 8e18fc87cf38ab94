//! `cutwater schema`

use crate::Error;
use crate::scene::schema;

/// Print the JSON schema of scene files, for completion and checks in editors
#[derive(Debug, clap::Args)]
pub(super) struct Schema {}

impl Schema {
    pub(super) fn run(&self) -> Result<(), Error> {
        say!("{:#}", schema::schema()?);
        Ok(())
    }
}
