//! VTK's XML files: vtkio serialises them, and their arrays are compressed here.
//!
//! vtkio 0.7.0-rc2 announces one block too many for a compressed array of a multiple of 32768 bytes (every 32^3 field), which VTK refuses. Here
//! each array is one block, smaller than the block size: the only form that both VTK and vtkio's own reader accept at every length. There is none for
//! an empty array, so a file with one is not compressed.

use std::io::Write;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use vtkio::Vtk;
use vtkio::model::{ByteOrder, DataSet, Version};
use vtkio::xml::Compressor;

use super::atomic::write_atomically;
use crate::Error;

/// For frames: higher levels save little on floating-point numbers.
pub(super) const FAST: Compression = Compression::fast();
/// For files that are written once.
pub(super) const SMALL: Compression = Compression::best();

/// Serialises in memory first: vtkio's own export ignores errors of its last flush, so a full disk would leave half a file.
pub(super) fn write(path: &Path, data: DataSet, level: Compression) -> Result<(), Error> {
    let vtk = Vtk {
        version: Version::new_xml(1, 0),
        title: String::new(),
        byte_order: ByteOrder::LittleEndian,
        data,
        file_path: None,
    };
    let file = vtk.try_into_xml_format(Compressor::None, 0).map_err(|problem| Error::output(path, problem))?;
    let mut bytes = Vec::new();
    file.write(&mut bytes).map_err(|problem| Error::output(path, problem))?;
    let text = String::from_utf8(bytes).map_err(|problem| Error::output(path, problem))?;
    // vtkio omits NumberOfPoints = 0, which readers require of every piece without an extent.
    let text = text.replacen("<Piece>", "<Piece NumberOfPoints=\"0\">", 1);
    let text = compressed(&text, level).unwrap_or(text);
    write_atomically(path, text.as_bytes())
}

/// The same file with compressed arrays; `None` if one is empty.
fn compressed(text: &str, level: Compression) -> Option<String> {
    const HEADER: &str = "header_type=\"UInt64\"";
    let mut rest = text;
    // Text before the content of an array, and the content.
    let mut arrays = Vec::new();
    while let Some(format) = rest.find("format=\"binary\"") {
        let start = format + rest[format..].find('>')? + 1;
        let end = start + rest[start..].find('<')?;
        arrays.push((&rest[..start], &rest[start..end]));
        rest = &rest[end..];
    }
    let contents: Option<Vec<String>> =
        arrays.par_iter().map(|(_, content)| compressed_array(content, level)).collect();
    let mut all = String::with_capacity(text.len());
    for ((before, _), content) in arrays.iter().zip(contents?) {
        all += before;
        all += &content;
    }
    all += rest;
    let with_compressor = format!("{HEADER} compressor=\"vtkZLibDataCompressor\"");
    Some(all.replacen(HEADER, &with_compressor, 1))
}

/// Content of a compressed array: number of blocks, size of a block and of the partial last one, compressed size; the block.
fn compressed_array(content: &str, level: Compression) -> Option<String> {
    // Begins with the length in bytes.
    let bytes = STANDARD.decode(content.trim()).ok()?;
    let data = bytes.get(8..).filter(|data| !data.is_empty())?;
    let mut encoder = ZlibEncoder::new(Vec::new(), level);
    encoder.write_all(data).ok()?;
    let block = encoder.finish().ok()?;
    let n = data.len() as u64;
    let header = [1, n + 1, n, block.len() as u64];
    let header: Vec<u8> = header.into_iter().flat_map(u64::to_le_bytes).collect();
    Some(STANDARD.encode(header) + &STANDARD.encode(block))
}
