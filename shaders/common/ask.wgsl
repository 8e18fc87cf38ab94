// Query of the active-set search by the host. Words 0 and 1: result, one number, or the numbers of penetrating nodes
// and of adhering contacts. Word 2: parameter.
const ANSWER = 0u;
const BEYOND = 0u;
const PULLED = 1u;
const TOLD = 2u;
