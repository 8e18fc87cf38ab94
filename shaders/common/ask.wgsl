// What the host asks kernels in the search for contacts. Words 0 and 1 are their answer: one number, or how many nodes are beyond a surface
// and how many are pulled. Word 2 is what the host tells them.
const ANSWER = 0u;
const BEYOND = 0u;
const PULLED = 1u;
const TOLD = 2u;
