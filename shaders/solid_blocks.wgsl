// solid_matrices: the 3x3 blocks zeta_K K_ij off the diagonal, one thread per entry of the sliced rows. Of the elements that join two nodes
// the block of the lower corner's row is formed and, where the row is the other's, transposed: K_ij and K_ji^T agree in all bits.
//   zeta_K K_ab = zeta_K V (lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I), g the rotated gradients
// rows. rotated: per element, rotated gradients of corners 1, 2, 3, 1/m, with zeta_K V lambda, zeta_K V mu (kg m^2/s) and det F.
// joints: where the joints of each entry start, one more than there are entries, then the joints, 16 element + 4 corner of the
// row + corner of the column. neighbours: column of each entry. blocks: see rows, out.
#import dispatch
#import real
#import inner
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> rotated: array<Real4>;
@group(0) @binding(2) var<storage, read> joints: array<u32>;
@group(0) @binding(3) var<storage, read> neighbours: array<u32>;
@group(0) @binding(4) var<storage, read_write> blocks: array<Inner4>;

fn gradient(element: u32, corner: u32) -> Real3 {
    if corner == 0u {
        return -(rotated[element].xyz + rotated[rows.n_elements + element].xyz + rotated[2u * rows.n_elements + element].xyz);
    }
    return rotated[(corner - 1u) * rows.n_elements + element].xyz;
}

@compute @workgroup_size(WG_SIZE)
fn solid_blocks(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let entry = linear_index(workgroup, lane);
    if entry >= rows.n_entries {
        return;
    }
    // Columns.
    var x = Real3();
    var y = Real3();
    var z = Real3();
    let last = joints[entry + 1u];
    for (var at = joints[entry]; at < last; at++) {
        let joint = joints[at];
        let element = joint / 16u;
        let row = joint / 4u % 4u;
        let column = joint % 4u;
        let low = gradient(element, min(row, column));
        let high = gradient(element, max(row, column));
        let lambda = rotated[element].w;
        let mu = rotated[rows.n_elements + element].w;
        let first = lambda * low;
        let second = mu * high;
        let third = mu * dot(low, high);
        // Columns of the block in the row of the lower corner.
        let a = first * high.x + second * low.x + Real3(third, Real(0.0), Real(0.0));
        let b = first * high.y + second * low.y + Real3(Real(0.0), third, Real(0.0));
        let c = first * high.z + second * low.z + Real3(Real(0.0), Real(0.0), third);
        if row < column {
            x += a;
            y += b;
            z += c;
        } else {
            x += Real3(a.x, b.x, c.x);
            y += Real3(a.y, b.y, c.y);
            z += Real3(a.z, b.z, c.z);
        }
    }
    let at = block_at(entry);
    blocks[at] = Inner4(Inner3(x), Inner(neighbours[entry]));
    blocks[at + SLICE] = Inner4(Inner3(y), Inner(0.0));
    blocks[at + 2u * SLICE] = Inner4(Inner3(z), Inner(0.0));
}
