// Tiles of 8 x 8 x 8 cells that cover every cell and every face: stages::Tiles is the same struct on the host.
struct Tiles {
    n: vec3<u32>,
    // By how many tiles the band reaches beyond the liquid.
    reach: u32,
}
