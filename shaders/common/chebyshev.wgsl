#import inner
#import real
#import rows

// Chebyshev iteration on S z = r, preconditioned by the blocks D on the diagonal of S, from zero: z = p(D^-1 S) D^-1 r with a fixed polynomial
// p, positive on the spectrum, so that z is linear in r, symmetric and positive. solver::Polynomial is the same struct on the host.
const DEGREES = 65u;

struct Polynomial {
    degree: u32,
    // That which the solids ask for, where it is higher: the host's to know.
    wanted: u32,
    pad_0: u32,
    pad_1: u32,
    // Weights of step k: of the last increment, of D^-1 times the residual.
    weights: array<vec4<f32>, DEGREES>,
}

// Step k for the row in a slot; the last one gives z and the row's share of r . z. Iterates alternate between the sections of pair.
// The including file declares rows: Rows, polynomial: Polynomial, list, blocks and inverse (see rows, solid_diagonals), r: array<Real4>,
// and, written, pair: array<Inner4> (two sections), increment: array<Inner4>, z: array<Real4>, partials: array<Real4>.
fn chebyshev_step(slot: u32, k: u32) {
    let node = list[slot];
    let n = rows.n_nodes;
    let right = r[node].xyz;
    let diagonal = inverse[node];
    let others = inverse[n + node];
    var defect = Inner3(right);
    var x = Inner3();
    var last = Inner3();
    if k > 0u {
        let from_section = select(0u, n, k % 2u == 0u);
        x = pair[from_section + node].xyz;
        last = increment[node].xyz;
        // (S x)_i = zeta_M m_i x_i + sum_j zeta_K K_ij (x_j - x_i): a translation strains nothing in any precision.
        var product = diagonal.w * x;
        let slice = rows.slices + slot / SLICE;
        let end = list[slice + 1u];
        for (var entries = list[slice]; entries < end; entries++) {
            let at = entries * 3u * SLICE + slot % SLICE;
            let column = blocks[at];
            let difference = pair[from_section + u32(column.w)].xyz - x;
            product += column.xyz * difference.x + blocks[at + SLICE].xyz * difference.y
                + blocks[at + 2u * SLICE].xyz * difference.z;
        }
        defect -= product;
    }
    let scaled = Inner3(
        diagonal.x * defect.x + others.x * defect.y + others.y * defect.z,
        others.x * defect.x + diagonal.y * defect.y + others.z * defect.z,
        others.y * defect.x + others.z * defect.y + diagonal.z * defect.z,
    );
    let weights = polynomial.weights[k];
    let step = Inner(weights.x) * last + Inner(weights.y) * scaled;
    let next = x + step;
    increment[node] = Inner4(step, Inner(0.0));
    pair[select(n, 0u, k % 2u == 0u) + node] = Inner4(next, Inner(0.0));
    if k == polynomial.degree {
        // The inverse is free of what is held up to the rounding of its entries: not enough for an outer loop in f64.
        let along = Real3(inverse[2u * n + node].xyz);
        let free = Real3(next) - along * (dot(along, Real3(next)) / max(dot(along, along), Real(0.5)));
        z[node] = Real4(free, Real(0.0));
        partials[slot] = Real4(dot(right, free), Real(0.0), Real(0.0), Real(0.0));
    }
}
