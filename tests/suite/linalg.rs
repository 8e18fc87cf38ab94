//! Sparse matrices, Cholesky, conjugate gradients and Matrix Market files against known answers.

use std::fs;

use cutwater::linalg::{
    CgEnd, Csr, LinearOperator, SymbolicCholesky, Symmetry, conjugate_gradient, conjugate_gradient_with_test,
    eigenvalues, inverse_one_norm, largest_magnitude, matrix_text, minimal_residual, norm, read_matrix, read_vector,
    smallest_magnitude, vector_text,
};

/// The 1D Laplacian with p = 0 beyond both ends; entry (i, j) of its inverse is min(i, j) (n + 1 - max(i, j)) / (n + 1).
fn laplacian(n: usize) -> Csr {
    let entries = (0..n).flat_map(|i| {
        let neighbours = [(i > 0).then(|| i - 1), (i + 1 < n).then_some(i + 1)];
        neighbours.into_iter().flatten().map(move |j| (i, j, -1.0)).chain([(i, i, 2.0)])
    });
    Csr::from_triplets(n, n, entries).unwrap()
}

struct Diagonal(Vec<f64>);

impl LinearOperator for Diagonal {
    fn size(&self) -> usize {
        self.0.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        (0..x.len()).for_each(|i| y[i] = self.0[i] * x[i]);
    }
}

#[test]
fn triplets_are_sorted_and_added() {
    let triplets = [(2, 1, 4.0), (0, 2, 1.0), (2, 1, 0.5), (0, 0, 3.0), (1, 1, -2.0)];
    let matrix = Csr::from_triplets(3, 4, triplets).unwrap();
    assert_eq!(matrix.triplets().collect::<Vec<_>>(), [(0, 0, 3.0), (0, 2, 1.0), (1, 1, -2.0), (2, 1, 4.5)]);
    let mut y = vec![0.0; 3];
    matrix.multiply(&[1.0, 10.0, 100.0, 1000.0], &mut y);
    assert_eq!(y, [103.0, -20.0, 45.0]);
    assert_eq!(matrix.transpose().get(1, 2), 4.5);
    assert_eq!((matrix.diagonal(), matrix.infinity_norm()), (vec![3.0, -2.0, 0.0], 4.5));
    assert_eq!(matrix.frobenius_norm(), (9.0 + 1.0 + 4.0 + 20.25_f64).sqrt());
    let error = Csr::from_triplets(3, 3, [(0, 3, 1.0)]).unwrap_err().to_string();
    assert!(error.contains("(0, 3)") && error.contains("3 x 3"), "{error}");
}

#[test]
fn asymmetry_is_the_largest_difference() {
    assert_eq!(laplacian(5).asymmetry(), 0.0);
    assert_eq!(Csr::from_triplets(2, 2, [(0, 1, 1.0), (1, 0, 3.0)]).unwrap().asymmetry(), 2.0);
}

#[test]
fn cholesky_inverts_and_reuses_its_symbols() {
    let n = 40;
    let matrix = laplacian(n);
    let symbolic = SymbolicCholesky::new(&matrix).unwrap();
    let factor = symbolic.factorise(&matrix).unwrap();
    for j in [0, 17, n - 1] {
        let mut x = vec![0.0; n];
        x[j] = 1.0;
        factor.solve(&mut x);
        for (i, value) in x.iter().enumerate() {
            let exact = ((i.min(j) + 1) * (n - i.max(j))) as f64 / (n + 1) as f64;
            assert!(
                (value - exact).abs() < 1e-12 * n as f64,
                "entry ({i}, {j}) of the inverse is {value}, not {exact}"
            );
        }
    }
    // Twice the matrix, the same pattern.
    let doubled = Csr::from_triplets(n, n, matrix.triplets().map(|(i, j, a)| (i, j, 2.0 * a))).unwrap();
    let mut x = vec![1.0; n];
    symbolic.factorise(&doubled).unwrap().solve(&mut x);
    assert!((x[n / 2] - (n / 2 + 1) as f64 * (n - n / 2) as f64 / 4.0).abs() < 1e-10, "{}", x[n / 2]);
}

#[test]
fn cholesky_refuses_an_indefinite_matrix() {
    let matrix = Csr::from_triplets(2, 2, [(0, 0, 1.0), (0, 1, 2.0), (1, 0, 2.0), (1, 1, 1.0)]).unwrap();
    let error = SymbolicCholesky::new(&matrix).unwrap().factorise(&matrix).unwrap_err().to_string();
    assert!(error.contains("not positive definite"), "{error}");
}

#[test]
fn conjugate_gradient_ends_within_n_steps_and_tells_how() {
    let n = 30;
    let matrix = laplacian(n);
    let jacobi = Diagonal(vec![0.5; n]);
    let b: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
    let mut x = vec![7.0; n];
    let report = conjugate_gradient(&matrix, &jacobi, &b, &mut x, 1e-12, 2 * n);
    assert_eq!(report.end, CgEnd::Converged);
    assert!(report.iterations <= n, "{} iterations for {n} unknowns", report.iterations);
    let mut residual = vec![0.0; n];
    matrix.multiply(&x, &mut residual);
    residual.iter_mut().zip(&b).for_each(|(r, b)| *r -= b);
    assert!(norm(&residual) < 1e-10 * norm(&b), "true residual {}", norm(&residual));

    let cut = conjugate_gradient(&matrix, &jacobi, &b, &mut x, 1e-12, 5);
    assert_eq!((cut.end, cut.iterations), (CgEnd::IterationLimit, 5));
    let zero = conjugate_gradient(&matrix, &jacobi, &vec![0.0; n], &mut x, 1e-12, n);
    assert_eq!((zero.end, zero.iterations, norm(&x)), (CgEnd::Converged, 0, 0.0));
    let negative = Diagonal((0..n).map(|i| if i == 3 { -1.0 } else { 1.0 }).collect());
    assert_eq!(conjugate_gradient(&negative, &jacobi, &b, &mut x, 1e-12, n).end, CgEnd::Breakdown);
}

#[test]
fn judged_conjugate_gradient_goes_on_from_where_it_is() {
    let n = 60;
    let matrix = laplacian(n);
    let jacobi = Diagonal((0..n).map(|i| 0.5 + 0.4 * (i as f64).sin()).collect());
    let b: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
    let (mut whole, mut parts) = (vec![7.0; n], vec![-7.0; n]);
    let reference = conjugate_gradient(&matrix, &jacobi, &b, &mut whole, 1e-9, 2 * n);
    let mut judgements = 0;
    let report = conjugate_gradient_with_test(&matrix, &jacobi, &b, &mut parts, 1e-3, 2 * n, |x| {
        let mut residual = vec![0.0; n];
        matrix.multiply(x, &mut residual);
        residual.iter_mut().zip(&b).for_each(|(r, b)| *r -= b);
        judgements += 1;
        let left = 1e-9 * norm(&b) / norm(&residual);
        (left < 1.0).then_some(left)
    });
    assert_eq!((report.end, judgements), (CgEnd::Converged, 2));
    // What was asked twice takes as long as what was asked at once, and both find the same; in the last bits the sums differ.
    assert!(
        report.iterations.abs_diff(reference.iterations) <= 1,
        "{} iterations, {} at once",
        report.iterations,
        reference.iterations
    );
    let off: Vec<f64> = whole.iter().zip(&parts).map(|(a, b)| a - b).collect();
    assert!(norm(&off) < 1e-6 * norm(&whole), "off by {}", norm(&off));

    let mut solve = |matrix: &Diagonal, b: &[f64], most, next| {
        let one = Diagonal(vec![1.0; n]);
        conjugate_gradient_with_test(matrix, &one, b, &mut parts, 1e-3, most, |_| next)
    };
    let ugly = Diagonal((1..=n).map(|i| (i * i) as f64).collect());
    let enough = solve(&ugly, &b, 2 * n, None);
    assert_eq!(enough.end, CgEnd::Converged);
    let limited = solve(&ugly, &b, enough.iterations + 2, Some(0.0));
    assert_eq!((limited.end, limited.iterations), (CgEnd::IterationLimit, enough.iterations + 2));
    for next in [None, Some(0.5)] {
        let zero = solve(&ugly, &vec![0.0; n], n, next);
        assert_eq!((zero.end, zero.iterations), (CgEnd::Converged, 0));
    }
    let negative = Diagonal((0..n).map(|i| if i == 3 { -1.0 } else { 1.0 }).collect());
    assert_eq!(solve(&negative, &b, n, None).end, CgEnd::Breakdown);
    let lost = vec![f64::NAN; n];
    assert_eq!(solve(&ugly, &lost, n, None).end, CgEnd::Breakdown);
}

/// [A B; B^T -A] with A the Laplacian, B a diagonal of both signs.
fn quasi_definite(n: usize) -> Csr {
    let a = laplacian(n);
    let b: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
    Csr::bordered(&a, &Csr::diagonal_of(&b), -1.0, &a)
}

#[test]
fn minimal_residuals_solve_what_is_not_definite() {
    let n = 60;
    let matrix = quasi_definite(n);
    let b: Vec<f64> = (0..2 * n).map(|i| ((i * i) as f64).cos()).collect();
    let symbolic = SymbolicCholesky::new(&matrix).unwrap();
    let mut exact = b.clone();
    symbolic.factorise_quasi_definite(&matrix).unwrap().solve(&mut exact);
    let off = |x: &[f64]| {
        let pairs = x.iter().zip(&exact);
        let differences: Vec<f64> = pairs.map(|(a, b)| a - b).collect();
        norm(&differences) / norm(&exact)
    };
    let mut x = vec![f64::NAN; 2 * n];
    let diagonal = Diagonal((0..2 * n).map(|i| 0.5 + (i % 3) as f64).collect());
    for preconditioner in [&Diagonal(vec![1.0; 2 * n]), &diagonal] {
        let report = minimal_residual(&matrix, preconditioner, &b, &mut x, 1e-12, 400);
        assert_eq!(report.end, CgEnd::Converged, "{report:?}");
        assert!(off(&x) < 1e-9, "{}", off(&x));
    }
    // With |A|^-1 the eigenvalues are 1 and -1: two iterations.
    let both = Diagonal(vec![0.25, 0.5]);
    let two = Csr::from_triplets(2, 2, [(0, 0, 4.0), (1, 1, -2.0)]).unwrap();
    let mut x = [0.0; 2];
    let report = minimal_residual(&two, &both, &[1.0, 1.0], &mut x, 1e-12, 10);
    assert_eq!((report.end, report.iterations), (CgEnd::Converged, 2));
    assert!((x[0] - 0.25).abs() < 1e-15 && (x[1] + 0.5).abs() < 1e-15);

    let report = minimal_residual(&matrix, &diagonal, &b, &mut vec![0.0; 2 * n], 1e-12, 5);
    assert_eq!((report.end, report.iterations), (CgEnd::IterationLimit, 5), "five are too few");
    let mut x = vec![1.0; 2 * n];
    let report = minimal_residual(&matrix, &diagonal, &vec![0.0; 2 * n], &mut x, 1e-12, 5);
    assert_eq!((report.end, norm(&x)), (CgEnd::Converged, 0.0));
    let indefinite = Diagonal((0..2 * n).map(|i| 0.5 - (i % 2) as f64).collect());
    let report = minimal_residual(&matrix, &indefinite, &b, &mut x, 1e-12, 400);
    assert_eq!(report.end, CgEnd::Breakdown, "{report:?}");
}

#[test]
fn extreme_eigenvalues_are_those_of_the_laplacian() {
    for n in [100, 1000] {
        let matrix = laplacian(n);
        // 2 - 2 cos(k pi / (n + 1)), k = 1..n
        let exact = |k: usize| 2.0 - 2.0 * (k as f64 * std::f64::consts::PI / (n + 1) as f64).cos();
        let symbolic = SymbolicCholesky::new(&matrix).unwrap();
        let factor = symbolic.factorise(&matrix).unwrap();
        let largest = largest_magnitude(&matrix).unwrap();
        assert!((largest / exact(n) - 1.0).abs() < 1e-3, "{n}: {largest}");
        let mut solves = 0;
        let smallest = smallest_magnitude(n, &mut |b| {
            solves += 1;
            let mut x = b.to_vec();
            factor.solve(&mut x);
            Ok(x)
        });
        let smallest = smallest.unwrap();
        assert!((smallest / exact(1) - 1.0).abs() < 1e-3, "{n}: {smallest}");
        assert!(solves < 30, "{n}: {solves}");
        // Rows of the inverse add up to i (n + 1 - i) / 2, i = 1..n.
        let of_inverse = inverse_one_norm(n, &mut |b| {
            let mut x = b.to_vec();
            factor.solve(&mut x);
            Ok(x)
        });
        let middle = (n / 2) as f64;
        let exact_norm = 0.5 * middle * ((n + 1) as f64 - middle);
        let of_inverse = of_inverse.unwrap();
        assert!((of_inverse / exact_norm - 1.0).abs() < 1e-10, "{n}: {of_inverse}");
        if n == 100 {
            let all = eigenvalues(&matrix).unwrap();
            for (k, value) in all.iter().enumerate() {
                assert!((value - exact(k + 1)).abs() < 1e-13, "{k}");
            }
        }
    }
    let singular = smallest_magnitude(3, &mut |_| Ok(vec![f64::INFINITY; 3])).unwrap_err();
    assert_eq!(singular.exit_code(), 2);
}

#[test]
fn matrix_market_files_come_back_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mtx");
    let mut entries: Vec<_> = laplacian(6).triplets().collect();
    entries.iter_mut().for_each(|e| e.2 /= 3.0);
    let symmetric = Csr::from_triplets(6, 6, entries).unwrap();
    let text = matrix_text(&symmetric, Symmetry::Symmetric, "two\nlines");
    assert!(text.starts_with("%%MatrixMarket matrix coordinate real symmetric\n% two\n% lines\n6 6 11\n"), "{text}");
    fs::write(&path, text).unwrap();
    assert_eq!(read_matrix(&path).unwrap(), symmetric);

    let general = Csr::from_triplets(2, 3, [(0, 2, 1.0 / 3.0), (1, 0, -1e-300)]).unwrap();
    fs::write(&path, matrix_text(&general, Symmetry::General, "")).unwrap();
    assert_eq!(read_matrix(&path).unwrap(), general);

    let vector = [0.1, -2.0 / 3.0, f64::MIN_POSITIVE, 0.0];
    fs::write(&path, vector_text(&vector, "")).unwrap();
    assert_eq!(read_vector(&path).unwrap(), vector);
}

#[test]
fn matrix_market_errors_name_line_and_cure() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.mtx");
    let banner = "%%MatrixMarket matrix coordinate real symmetric\n";
    for (text, expected) in [
        ("1 1 1\n".to_string(), ":1: the first line is not the banner"),
        (banner.replace("symmetric", "hermitian"), "`hermitian` is not supported"),
        (format!("{banner}2 3 1\n1 1 1\n"), ":2: a symmetric matrix cannot be 2 x 3"),
        (format!("{banner}%\n2 2 2\n1 1 1\n"), "the file ends where `row column value` should follow"),
        (format!("{banner}2 2 1\n\n1 1 x\n"), ":4: `x` is not a number"),
        (format!("{banner}2 2 1\n1 1\n"), ":3: `1 1` is not `row column value`"),
        (format!("{banner}2 2 1\n3 1 1\n"), ":3: entry (3, 1) lies outside"),
        (format!("{banner}2 2 1\n1 2 1\n"), ":3: entry (1, 2) lies above the diagonal"),
        (format!("{banner}2 2 1\n1 1 1\n2 2 1\n"), ":4: `2 2 1` follows the last entry"),
    ] {
        fs::write(&path, &text).unwrap();
        let error = read_matrix(&path).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("cure"), "{text:?} gives {error:?}");
    }
    fs::write(&path, "%%MatrixMarket matrix array real general\n2 2\n").unwrap();
    assert!(read_vector(&path).unwrap_err().to_string().contains("cannot have 2 columns"));
    assert!(read_vector(&folder.path().join("none.mtx")).unwrap_err().to_string().contains("none.mtx"));
}
