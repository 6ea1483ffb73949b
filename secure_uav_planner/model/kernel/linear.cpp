#include "linear.hpp"

#include <numeric>
#include <utility>

namespace kernel {

namespace {

// Least ratio of a pivot of one row and the largest entry beside it, (1 + sqrt(17)) / 8.
constexpr double PIVOT_RATIO = 0.6403882032022076;

// Return the column, from k on, of a row's entry off the diagonal with the largest absolute value,
// or `row` if all these entries are 0.
int find_largest(const double* matrix, int size, int k, int row) {
    int largest = row;
    double most = 0.0;
    for (int j = k; j < size; ++j) {
        const double entry = std::fabs(matrix[row * size + j]);
        if (j == row || !(entry > most)) continue;
        most = entry;
        largest = j;
    }
    return largest;
}

// Return the two rows, from k on, of the next pivot, or one row twice for a pivot of one row. One
// row suffices if the largest diagonal entry is at least PIVOT_RATIO times the largest other entry
// of this row. Otherwise it is a rook pivot: the entry that both rows have in common is the largest
// off the diagonal in both. No multiplier exceeds 2.8.
std::pair<int, int> choose_pivot(const double* matrix, int size, int k) {
    const auto entry = [=](int i, int j) { return std::fabs(matrix[i * size + j]); };
    int first = k;
    for (int i = k + 1; i < size; ++i)
        if (entry(i, i) > entry(first, first)) first = i;
    int second = find_largest(matrix, size, k, first);
    if (entry(first, first) >= PIVOT_RATIO * entry(first, second)) return {first, first};
    for (;;) {
        const int next = find_largest(matrix, size, k, second);
        if (!(entry(second, next) > entry(first, second))) return {first, second};
        first = second;
        second = next;
    }
}

// Eliminate row k of a symmetric matrix from the rows below. Return -pivot, the shift to 0, for a
// negative pivot, otherwise 0. From row k on, column k of the matrix becomes column k of L.
double eliminate_row(double* matrix, int size, int k) {
    double* upper = matrix + k * size;
    const double pivot = upper[k];
    if (pivot == 0.0) return 0.0;  // All of the row is 0.
    const double inverse = 1.0 / pivot;
    for (int i = k + 1; i < size; ++i) {
        double* __restrict row = matrix + i * size;
        const double multiplier = upper[i] * inverse;
        for (int j = k + 1; j < size; ++j) row[j] -= multiplier * upper[j];
        row[k] = multiplier;
    }
    upper[k] = 1.0;
    return std::max(0.0, -pivot);
}

// Eliminate rows k and k + 1, whose block (p, q; q, r) has one negative eigenvalue, from the rows
// below. Return minus this eigenvalue, which is the shift that makes it 0. Put into column k, from
// row k on, the vector L v that belongs to the shift, where v = (x, y) is the unit eigenvector.
double eliminate_pair(double* matrix, int size, int k) {
    double *upper = matrix + k * size, *lower = upper + size;
    const double p = upper[k], q = upper[k + 1], r = lower[k + 1], inverse = 1.0 / (p * r - q * q);
    const double half = 0.5 * (p - r), root = std::sqrt(half * half + q * q);
    const double scale = 1.0 / std::sqrt(2.0 * root * (root + std::fabs(half)));
    const double x = scale * (half < 0.0 ? root - half : -q);
    const double y = scale * (half < 0.0 ? -q : root + half);
    for (int i = k + 2; i < size; ++i) {
        double* __restrict row = matrix + i * size;
        const double of_upper = (r * upper[i] - q * lower[i]) * inverse;
        const double of_lower = (p * lower[i] - q * upper[i]) * inverse;
        for (int j = k + 2; j < size; ++j) row[j] -= of_upper * upper[j] + of_lower * lower[j];
        row[k] = x * of_upper + y * of_lower;
    }
    upper[k] = x;
    lower[k] = y;
    return root - 0.5 * (p + r);
}

// Factor a symmetric matrix A, (size, size), as P A P^T = L D L^T, where D has blocks of one or two
// rows (Ashcraft, Grimes and Lewis, 1998). Row i of P A P^T is row order[i] of A.
//
// Put into `shifts`, zeros before, minus each negative eigenvalue of D (Cheng and Higham, 1998).
// Column k of the matrix becomes, from the diagonal on, the vector l_k such that adding
// shifts[k] l_k l_k^T to P A P^T makes the eigenvalue 0.
void factor_with_pivots(double* matrix, int size, int* order, double* shifts) {
    std::iota(order, order + size, 0);
    for (int k = 0, rows; k < size; k += rows) {
        // Entries above row k are not used again, so they need no swap.
        const auto swap = [=](int i, int j) {
            if (i == j) return;
            std::swap(order[i], order[j]);
            std::swap_ranges(matrix + i * size, matrix + (i + 1) * size, matrix + j * size);
            for (int row = k; row < size; ++row)
                std::swap(matrix[row * size + i], matrix[row * size + j]);
        };
        const auto [first, second] = choose_pivot(matrix, size, k);
        rows = first == second ? 1 : 2;
        swap(k, first);
        if (rows == 2) swap(k + 1, second == k ? first : second);
        shifts[k] = rows == 1 ? eliminate_row(matrix, size, k) : eliminate_pair(matrix, size, k);
    }
}

// Add to the lower triangle of `sum` shifts[k] times the outer product of column k, from row k on,
// of a factored matrix, for all k. `vector` is space for `size` numbers.
void add_shifts(const double* factored, int size, const double* shifts, double* vector,
                double* sum) {
    for (int k = 0; k < size; ++k) {
        if (!(shifts[k] > 0.0)) continue;
        for (int i = k; i < size; ++i) vector[i] = factored[i * size + k];
        for (int i = k; i < size; ++i) {
            const double scaled = shifts[k] * vector[i];
            double* __restrict row = sum + i * size;
            for (int j = k; j <= i; ++j) row[j] += scaled * vector[j];
        }
    }
}

}  // namespace

// Replace A, given by its lower triangle, by a positive semidefinite modification E so that A + E
// is positive semidefinite: E makes the negative eigenvalues of D in P A P^T = L D L^T zero.
// `space`, size * (2 size + 2) numbers, gets a copy of A, P E P^T, a vector and the shifts.
void find_modification(double* matrix, int size, double* space) {
    double *a = space, *sum = a + size * size, *vector = sum + size * size, *shifts = vector + size;
    for (int i = 0; i < size; ++i)
        for (int j = 0; j <= i; ++j) a[i * size + j] = a[j * size + i] = matrix[i * size + j];
    std::fill(sum, shifts + size, 0.0);
    std::vector<int> order(size);
    factor_with_pivots(a, size, order.data(), shifts);
    add_shifts(a, size, shifts, vector, sum);
    for (int i = 0; i < size; ++i)
        for (int j = 0; j <= i; ++j)
            matrix[order[i] * size + order[j]] = matrix[order[j] * size + order[i]] =
                sum[i * size + j];
}

// Solve matrix x = right by Gaussian elimination with row pivots; x replaces the right side. The
// matrix, (size, size), is overwritten. Return false if the matrix is singular.
bool solve_dense(double* matrix, double* right, int size) {
    for (int i = 0; i < size; ++i) {
        int pivot = i;
        for (int k = i + 1; k < size; ++k)
            if (std::fabs(matrix[k * size + i]) > std::fabs(matrix[pivot * size + i])) pivot = k;
        if (!(std::fabs(matrix[pivot * size + i]) > 0.0)) return false;
        if (pivot != i) {
            for (int j = 0; j < size; ++j)
                std::swap(matrix[pivot * size + j], matrix[i * size + j]);
            std::swap(right[pivot], right[i]);
        }
        for (int k = i + 1; k < size; ++k) {
            const double multiplier = matrix[k * size + i] / matrix[i * size + i];
            for (int j = i + 1; j < size; ++j)
                matrix[k * size + j] -= multiplier * matrix[i * size + j];
            right[k] -= multiplier * right[i];
        }
    }
    for (int i = size - 1; i >= 0; --i) {
        for (int j = i + 1; j < size; ++j) right[i] -= matrix[i * size + j] * right[j];
        right[i] /= matrix[i * size + i];
    }
    return true;
}

}  // namespace kernel
