//! `cutwater schema`

use cutwater::Error;
use cutwater::scene::schema;

/// Print the JSON schema of scene files, from which editors complete and check
#[derive(Debug, clap::Args)]
pub(super) struct Schema {}

impl Schema {
    pub(super) fn run(&self) -> Result<(), Error> {
        say!("{:#}", schema::schema()?);
        Ok(())
    }
}
