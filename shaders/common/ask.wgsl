// What the host asks kernels in the search for contacts: the word that it tells them, after the words that they answer with: one number,
// or how many nodes are beyond a surface and how many pulled.
const ANSWER = 0u;
const BEYOND = 0u;
const PULLED = 1u;
const TOLD = 2u;
