// PCG for solids: one step of the Chebyshev iteration, one thread per row, for solids too large for chebyshev_polynomial.
// rows, polynomial. sweep: the step. The others: see chebyshev.
#import chebyshev
#import dispatch
#import inner
#import real

struct ChebyshevSweep {
    k: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<uniform> polynomial: Polynomial;
@group(0) @binding(2) var<uniform> sweep: ChebyshevSweep;
@group(0) @binding(3) var<storage, read> list: array<u32>;
@group(0) @binding(4) var<storage, read> blocks: array<Inner4>;
@group(0) @binding(5) var<storage, read> inverse: array<Inner4>;
@group(0) @binding(6) var<storage, read> r: array<Real4>;
@group(0) @binding(7) var<storage, read_write> pair: array<Inner4>;
@group(0) @binding(8) var<storage, read_write> increment: array<Inner4>;
@group(0) @binding(9) var<storage, read_write> z: array<Real4>;
@group(0) @binding(10) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn chebyshev_sweep(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = linear_index(workgroup, lane);
    if slot < rows.n_nodes {
        chebyshev_step(slot, sweep.k);
    }
}
