// Words of marker_counts, numbers of markers in this sub-step: spray after it has moved, spray that was lost on the way, markers deleted below
// the band, lost spray that left through open sides, lost spray that sank, and spray that landed.
const FLYING = 0u;
const LOST_SPRAY = 1u;
const DELETED = 2u;
const LEFT_SPRAY = 3u;
const SUNK_SPRAY = 4u;
const LANDED = 5u;
