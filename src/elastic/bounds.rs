//! Eigenvalue bounds of assembled matrices from those of the elements. An inequality of all elements is one of the assembled
//! matrix: x^T S x is the sum of x_e^T S_e x_e (Fried 1972). Rotations, constraints and time steps do not change the bounds,
//! which are computed once.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{Body, Solids, stiffness_block};

/// Squarings of the matrix in the trace bound, which exceeds the largest eigenvalue by at most 6^(1/1024) - 1 = 0.18 %.
const SQUARINGS: u32 = 10;

const ROUNDING: f64 = 1.0 + 1e-9;

const DEGREES: [f64; 2] = [8.0, 64.0];

/// Upper bounds of eigenvalues.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// Bound for D^-1 S with S = zeta_M M + zeta_K K, for all positive zeta_M and zeta_K and all rotations. D is the 3x3
    /// block diagonal. The bound also holds with constrained components.
    pub block_jacobi: f64,
    /// Bound for M^-1 K of each body, 1/s^2: the squared angular frequency of its lumped mesh.
    pub frequency_squared: Vec<f64>,
}

impl Bounds {
    /// Bounds of all solids.
    pub fn new(solids: &Solids) -> Bounds {
        let of_body = |body: &Body| -> [f64; 2] {
            let elements = body.elements.clone().into_par_iter();
            let bounds = elements.map(|element| {
                let gradients = &solids.gradients[element];
                [
                    largest_eigenvalue(body, gradients, |g| stiffness_block(g, g, body.lambda, body.mu).inverse()),
                    // A quarter of the element's mass over its volume.
                    largest_eigenvalue(body, gradients, |_| DMat3::from_diagonal(DVec3::splat(4.0 / body.density))),
                ]
            });
            bounds.reduce(|| [0.0; 2], |[a, b], [c, d]| [a.max(c), b.max(d)])
        };
        let bounds: Vec<[f64; 2]> = solids.bodies.iter().map(of_body).collect();
        let largest = bounds.iter().map(|[block_jacobi, _]| *block_jacobi);
        Bounds {
            // M alone has eigenvalue 1.
            block_jacobi: largest.fold(1.0, f64::max),
            frequency_squared: bounds.into_iter().map(|[_, square]| square).collect(),
        }
    }

    /// Degree of the Chebyshev polynomial in D^-1 S for a step of dt (s): ceil(sqrt(zeta_K lmax(M^-1 K) / zeta_M)), limited
    /// to 8..64.
    pub fn chebyshev_degree(&self, solids: &Solids, dt: f64) -> usize {
        self.chebyshev_degree_for(solids, |body| [body.zeta_mass(dt), body.zeta_stiffness(dt)])
    }

    /// The degree for given zeta_M (1/s) and zeta_K (s).
    pub fn chebyshev_degree_for(&self, solids: &Solids, zeta: impl Fn(&Body) -> [f64; 2]) -> usize {
        let [least, most] = DEGREES;
        let degree = self.unlimited_degree(solids, zeta);
        degree.max(least).min(most).ceil() as usize
    }

    /// The degree without limits: sqrt(zeta_K lmax(M^-1 K) / zeta_M), the maximum over all solids.
    pub fn unlimited_degree(&self, solids: &Solids, zeta: impl Fn(&Body) -> [f64; 2]) -> f64 {
        let degrees = solids.bodies.iter().zip(&self.frequency_squared);
        let degrees = degrees.map(|(body, square)| {
            let [mass, stiffness] = zeta(body);
            (stiffness * square / mass).sqrt()
        });
        degrees.fold(0.0, f64::max)
    }
}

/// Upper bound of the largest eigenvalue of D^-1 K_e / V. D is block diagonal; `inverse` computes a block of D^-1 from a
/// gradient.
///
/// With an orthonormal basis s_k of the symmetric tensors, K_e / V = G^T C G, where G_k(a, .) = s_k g_a and C = 2 mu I + lambda
/// tr tr^T. The nonzero eigenvalues of D^-1 G^T C G are those of the 6x6 matrix A = C (G D^-1 G^T), all real and positive, so
/// lmax <= (tr A^n)^(1/n).
fn largest_eigenvalue(body: &Body, gradients: &[DVec3; 4], inverse: impl Fn(DVec3) -> DMat3) -> f64 {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let tensor = |i: usize, j: usize, value: f64| {
        let mut columns = [[0.0; 3]; 3];
        columns[i][j] = value;
        columns[j][i] = value;
        DMat3::from_cols_array_2d(&columns)
    };
    let basis = [
        tensor(0, 0, 1.0),
        tensor(1, 1, 1.0),
        tensor(2, 2, 1.0),
        tensor(1, 2, half),
        tensor(0, 2, half),
        tensor(0, 1, half),
    ];
    let mut product = [[0.0; 6]; 6];
    for &gradient in gradients {
        let inverse = inverse(gradient);
        let strains = basis.map(|tensor| tensor * gradient);
        for (row, a) in product.iter_mut().zip(strains) {
            for (entry, b) in row.iter_mut().zip(strains) {
                *entry += a.dot(inverse * b);
            }
        }
    }
    let volumetric: [f64; 6] = std::array::from_fn(|column| (0..3).map(|row| product[row][column]).sum());
    for (k, row) in product.iter_mut().enumerate() {
        for (entry, sum) in row.iter_mut().zip(volumetric) {
            *entry = 2.0 * body.mu * *entry + if k < 3 { body.lambda * sum } else { 0.0 };
        }
    }
    // Logarithm of the divisors, per factor of the product.
    let mut logarithm = 0.0;
    let mut share = 1.0;
    for _ in 0..SQUARINGS {
        let trace: f64 = (0..6).map(|k| product[k][k]).sum();
        logarithm += share * trace.ln();
        let scaled = product.map(|row| row.map(|entry| entry / trace));
        product = std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| scaled[i][k] * scaled[k][j]).sum()));
        share *= 0.5;
    }
    let trace: f64 = (0..6).map(|k| product[k][k]).sum();
    (logarithm + share * trace.ln()).exp() * ROUNDING
}
