//! Matrix Market files (Boisvert, Pozo and Remington 1996): `coordinate real general` and `symmetric` matrices, `array real
//! general` vectors. Values have 17 digits, which preserve every bit.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use super::Csr;
use crate::Error;

/// Stored part of a matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symmetry {
    /// All entries.
    General,
    /// The lower triangle of a symmetric matrix.
    Symmetric,
}

/// File contents of a matrix; `comment` lines follow the banner.
pub fn matrix_text(matrix: &Csr, symmetry: Symmetry, comment: &str) -> String {
    let (name, lower) = match symmetry {
        Symmetry::General => ("general", false),
        Symmetry::Symmetric => ("symmetric", true),
    };
    let stored = || matrix.triplets().filter(move |(row, column, _)| !lower || row >= column);
    let mut text = format!("%%MatrixMarket matrix coordinate real {name}\n");
    push_comment(&mut text, comment);
    let _ = writeln!(text, "{} {} {}", matrix.n_rows(), matrix.n_columns(), stored().count());
    for (row, column, value) in stored() {
        let _ = writeln!(text, "{} {} {value:.17e}", row + 1, column + 1);
    }
    text
}

/// File contents of a vector, a one-column array.
pub fn vector_text(vector: &[f64], comment: &str) -> String {
    let mut text = String::from("%%MatrixMarket matrix array real general\n");
    push_comment(&mut text, comment);
    let _ = writeln!(text, "{} 1", vector.len());
    for value in vector {
        let _ = writeln!(text, "{value:.17e}");
    }
    text
}

/// Reads a coordinate matrix; a symmetric one is returned with both triangles.
pub fn read_matrix(path: &Path) -> Result<Csr, Error> {
    let text = read(path)?;
    let mut file = Reader::new(path, &text, "coordinate")?;
    let symmetric = match file.symmetry.as_str() {
        "general" => false,
        "symmetric" => true,
        other => {
            return Err(file.error(&format!("symmetry `{other}` is not supported"), "use general or symmetric"));
        }
    };
    let [n_rows, n_columns, n_entries] = file.numbers::<usize, 3>("rows columns entries")?;
    if symmetric && n_rows != n_columns {
        return Err(
            file.error(&format!("a symmetric matrix cannot be {n_rows} x {n_columns}"), "correct the size line")
        );
    }
    let mut triplets = Vec::new();
    for _ in 0..n_entries {
        let [row, column, value] = file.fields("row column value")?;
        let (row, column) = (file.number::<usize>(row)?, file.number::<usize>(column)?);
        let value = file.number::<f64>(value)?;
        if !(1..=n_rows).contains(&row) || !(1..=n_columns).contains(&column) {
            let problem = format!("entry ({row}, {column}) lies outside the {n_rows} x {n_columns} matrix");
            return Err(file.error(&problem, "rows and columns count from 1"));
        }
        if symmetric && column > row {
            let problem = format!("entry ({row}, {column}) lies above the diagonal of a symmetric matrix");
            return Err(file.error(&problem, "store the lower triangle only"));
        }
        triplets.push((row - 1, column - 1, value));
        if symmetric && row != column {
            triplets.push((column - 1, row - 1, value));
        }
    }
    file.end()?;
    Csr::from_triplets(n_rows, n_columns, triplets)
}

/// Reads a one-column array.
pub fn read_vector(path: &Path) -> Result<Vec<f64>, Error> {
    let text = read(path)?;
    let mut file = Reader::new(path, &text, "array")?;
    if file.symmetry != "general" {
        return Err(file.error("an array must be general", "write `%%MatrixMarket matrix array real general`"));
    }
    let [n, n_columns] = file.numbers::<usize, 2>("rows columns")?;
    if n_columns != 1 {
        return Err(file.error(&format!("a vector cannot have {n_columns} columns"), "give an n x 1 array"));
    }
    let mut vector = Vec::new();
    for _ in 0..n {
        vector.extend(file.numbers::<f64, 1>("value")?);
    }
    file.end()?;
    Ok(vector)
}

fn read(path: &Path) -> Result<String, Error> {
    fs::read_to_string(path).map_err(|problem| {
        Error::input(path.display().to_string(), problem.to_string(), "give a readable Matrix Market file")
    })
}

fn push_comment(text: &mut String, comment: &str) {
    for line in comment.lines() {
        let _ = writeln!(text, "% {line}");
    }
}

/// Noncomment lines with their numbers.
struct Reader<'a> {
    path: &'a Path,
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    /// Number of the last line read, from 1.
    line: usize,
    symmetry: String,
}

impl<'a> Reader<'a> {
    fn new(path: &'a Path, text: &'a str, format: &str) -> Result<Reader<'a>, Error> {
        let mut file = Reader { path, lines: text.lines().enumerate(), line: 1, symmetry: String::new() };
        let banner = file.lines.next().map_or(String::new(), |(_, line)| line.to_ascii_lowercase());
        match banner.split_whitespace().collect::<Vec<_>>()[..] {
            ["%%matrixmarket", "matrix", kind, "real", symmetry] if kind == format => {
                file.symmetry = symmetry.to_string();
                Ok(file)
            }
            _ => Err(file.error(
                &format!("the first line is not the banner of a real {format} matrix"),
                &format!("begin with `%%MatrixMarket matrix {format} real general`"),
            )),
        }
    }

    fn error(&self, problem: &str, cure: &str) -> Error {
        Error::input(format!("{}:{}", self.path.display(), self.line), problem, cure)
    }

    /// The next line that is neither blank nor a comment.
    fn next(&mut self) -> Option<&'a str> {
        let (index, line) =
            self.lines.by_ref().find(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('%'))?;
        self.line = index + 1;
        Some(line)
    }

    fn fields<const N: usize>(&mut self, names: &str) -> Result<[&'a str; N], Error> {
        let Some(line) = self.next() else {
            return Err(self.error(&format!("the file ends where `{names}` should follow"), "is the file cut off?"));
        };
        let fields: Vec<_> = line.split_whitespace().collect();
        fields.try_into().map_err(|_| self.error(&format!("`{line}` is not `{names}`"), "correct the line"))
    }

    fn number<T: std::str::FromStr>(&self, field: &str) -> Result<T, Error> {
        field.parse().map_err(|_| self.error(&format!("`{field}` is not a number of the right kind"), "correct it"))
    }

    fn numbers<T: std::str::FromStr + Copy + Default, const N: usize>(&mut self, names: &str) -> Result<[T; N], Error> {
        let fields = self.fields::<N>(names)?;
        let mut numbers = [T::default(); N];
        for (number, field) in numbers.iter_mut().zip(fields) {
            *number = self.number(field)?;
        }
        Ok(numbers)
    }

    fn end(&mut self) -> Result<(), Error> {
        match self.next() {
            None => Ok(()),
            Some(line) => Err(self.error(&format!("`{line}` follows the last entry"), "correct the entry count")),
        }
    }
}
