// PCG for solids: all steps of the Chebyshev iteration, one workgroup per solid, with barriers where chebyshev_sweep has dispatches.
// rows, polynomial. The others: see chebyshev.
#import chebyshev
#import inner
#import real

// As many as the rows of the largest solid that is given to a workgroup: BODY_NODES of solver/solid_solver.rs.
const BODY_THREADS = 256u;

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<uniform> polynomial: Polynomial;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> blocks: array<Inner4>;
@group(0) @binding(4) var<storage, read> inverse: array<Inner4>;
@group(0) @binding(5) var<storage, read> r: array<Real4>;
@group(0) @binding(6) var<storage, read_write> pair: array<Inner4>;
@group(0) @binding(7) var<storage, read_write> increment: array<Inner4>;
@group(0) @binding(8) var<storage, read_write> z: array<Real4>;
@group(0) @binding(9) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(BODY_THREADS)
fn chebyshev_polynomial(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first = list[rows.bodies + workgroup.x];
    let end = list[rows.bodies + workgroup.x + 1u];
    for (var k = 0u; k <= polynomial.degree; k++) {
        for (var slot = first + lane; slot < end; slot += BODY_THREADS) {
            chebyshev_step(slot, k);
        }
        storageBarrier();
        workgroupBarrier();
    }
}
