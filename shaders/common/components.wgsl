// Connected components of active cells. The label of a cell is the scalar index of another cell of its component, not above its own,
// in the end of the smallest one, the root. OPEN is set in the labels of roots, in the end of all cells, whose component
// has a free surface or a solid that gives way, SEALED also where it is the solid alone; both in inactive lanes.
const OPEN = 0x80000000u;
const SEALED = 0x40000000u;
const MARKS = OPEN | SEALED;
const NONE = 0xffffffffu;

// Words of the state.
const N_CLOSED = 0u;    // closed components of this step
const COUNTER = 1u;     // the same while it is being counted
const QUADS = 2u;       // active quads of level 0
const SEALS = 3u;       // sealed components while they are being counted
const LARGEST = 4u;     // f32 bits of the largest magnitude in closed components: of the right-hand side, of the potential
const LOOSE = 6u;       // components that touch nothing while they are being counted

// List entries per thread of the kernels that sum over components.
const RUN = 16u;
