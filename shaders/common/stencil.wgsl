#import level
#import real
#import inner

// The operator of a level on a quad, in difference form so that rounding follows the differences and not the values:
//   (B x)_c = dirichlet_c x_c + sum over faces of w_f (x_c - x_nb).
// The including file declares x (the field, array<Real4>) and matrix (array<Inner4>, see level). q counts from the start of the arrays.

struct Row {
    bx: Real4,
    x: Real4,
}

fn row_of(level: Level, q: u32, uniform_quad: bool) -> Row {
    let sy = level.shape.stride_y;
    let sz = level.shape.stride_z;
    let c = x[q];
    let xm = c - Real4(x[q - 1u].w, c.xyz);
    let xp = c - Real4(c.yzw, x[q + 1u].x);
    let ym = c - x[q - sy];
    let yp = c - x[q + sy];
    let zm = c - x[q - sz];
    let zp = c - x[q + sz];
    if uniform_quad {
        return Row(Real(level.coefficient) * (((xm + xp) + (ym + yp)) + (zm + zp)), c);
    }
    let total = level.shape.total;
    let wx = Real4(matrix[q]);
    let wxp = Real4(wx.yzw, Real(matrix[q + 1u].x));
    let bx = Real4(matrix[DIRICHLET * total + q]) * c
        + ((wx * xm + wxp * xp)
        + (Real4(matrix[total + q]) * ym + Real4(matrix[total + q + sy]) * yp))
        + (Real4(matrix[2u * total + q]) * zm + Real4(matrix[2u * total + q + sz]) * zp);
    return Row(bx, c);
}

fn inv_diagonal(level: Level, q: u32, uniform_quad: bool) -> Real4 {
    if uniform_quad {
        return Real4(Real(1.0) / (Real(6.0) * Real(level.coefficient)));
    }
    return Real4(matrix[INV_DIAGONAL * level.shape.total + q]);
}
