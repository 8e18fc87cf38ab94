//! The polynomial of the solids' preconditioner.

use crate::elastic::{Body, Bounds, Solids};

/// Largest degree; `common/chebyshev.wgsl` has room for as many steps and one.
pub(super) const MAX_DEGREE: usize = 64;

/// Largest wanted degree over the degree.
const SHORT: u32 = 2;

/// The Chebyshev iteration of `shaders/common/chebyshev.wgsl`: z = p(D^-1 S) D^-1 r with p of this degree, for eigenvalues of
/// D^-1 S in [`largest` / (0.7 degree^2), `largest`]. p is positive for smaller eigenvalues too, so z is
/// symmetric and positive in r, whatever the lower end, as long as none is above.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Polynomial {
    /// Products with S.
    pub degree: u32,
    /// The degree that the solids ask for, where it is higher (`Bounds::unlimited_degree`).
    pub wanted: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
    /// Weights of each step: of the last increment, of D^-1 times the residual.
    pub weights: [[f32; 4]; MAX_DEGREE + 1],
}

impl Polynomial {
    /// Polynomial of a degree (64 at most), for eigenvalues up to `largest`. Degree 0 is D^-1 alone.
    ///
    /// # Panics
    /// When the degree is larger.
    pub fn new(degree: usize, largest: f64) -> Polynomial {
        assert!(degree <= MAX_DEGREE, "degree {degree} of the polynomial");
        // No narrower than a factor of two, for the small degrees that nobody needs.
        let ratio = (0.7 * (degree * degree) as f64).max(2.0);
        let (low, high) = (largest / ratio, largest);
        let (centre, half) = (0.5 * (high + low), 0.5 * (high - low));
        let mut weights = [[0.0; 4]; MAX_DEGREE + 1];
        weights[0][1] = if degree == 0 { 1.0 } else { 1.0 / centre } as f32;
        let twice = 2.0 * centre / half;
        let mut rho = half / centre;
        for weights in &mut weights[1..=degree] {
            let next = 1.0 / (twice - rho);
            *weights = [(next * rho) as f32, (2.0 * next / half) as f32, 0.0, 0.0];
            rho = next;
        }
        Polynomial { degree: degree as u32, wanted: degree as u32, pad_0: 0, pad_1: 0, weights }
    }

    /// Polynomial of solids for their zeta_M (1/s) and zeta_K (s) per body.
    pub fn for_solids(bounds: &Bounds, solids: &Solids, zeta: impl Fn(&Body) -> [f64; 2]) -> Polynomial {
        let degree = bounds.chebyshev_degree_for(solids, &zeta);
        Polynomial {
            // Infinity saturates.
            wanted: bounds.unlimited_degree(solids, zeta).ceil() as u32,
            ..Polynomial::new(degree, bounds.block_jacobi)
        }
    }

    /// Whether it stays so far below the degree that the solids ask for that two-field solves, whose iterations grow with the square of what is
    /// missing, may take more than the hundred which they are good for.
    pub(super) fn falls_short(&self) -> bool {
        self.wanted > SHORT * self.degree
    }
}
