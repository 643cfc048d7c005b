// The inner loop of BlockCholesky, for whatever vector registers the machine has.
#pragma once

namespace gastronaut::slam {

// c -= a b^T, blocks of kNodeUnknowns x kNodeUnknowns, column by column. The same bytes on every
// machine.
void subtract_product(const double* a, const double* b, double* c);

}  // namespace gastronaut::slam
