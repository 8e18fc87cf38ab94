#import real

// A symmetric 3x3 matrix.
struct Symmetric {
    // xx, yy, zz
    squares: Real3,
    // xy, xz, yz
    products: Real3,
}

fn times(m: Symmetric, x: Real3) -> Real3 {
    return m.squares * x + Real3(
        m.products.x * x.y + m.products.y * x.z,
        m.products.x * x.x + m.products.z * x.z,
        m.products.y * x.x + m.products.z * x.y,
    );
}

// m + weight v v^T
fn plus_outer(m: Symmetric, weight: Real, v: Real3) -> Symmetric {
    return Symmetric(m.squares + weight * (v * v), m.products + weight * (v.xxy * v.yzz));
}

// Of a positive definite one.
fn inverse_of(m: Symmetric) -> Symmetric {
    // L diag(pivots) L^T: no difference of nearly equal products.
    let pivot_x = m.squares.x;
    let yx = m.products.x / pivot_x;
    let zx = m.products.y / pivot_x;
    let pivot_y = m.squares.y - yx * m.products.x;
    let zy = (m.products.z - yx * m.products.y) / pivot_y;
    let pivot_z = m.squares.z - zx * m.products.y - zy * (m.products.z - yx * m.products.y);
    // L^-1 has -yx, -zy and this below its diagonal.
    let corner = yx * zy - zx;
    let i = Real3(Real(1.0)) / Real3(pivot_x, pivot_y, pivot_z);
    return Symmetric(
        Real3(i.x + yx * yx * i.y + corner * corner * i.z, i.y + zy * zy * i.z, i.z),
        Real3(-yx * i.y - corner * zy * i.z, corner * i.z, -zy * i.z),
    );
}
