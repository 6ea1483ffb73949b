#include "linear.hpp"

#include <limits>

namespace kernel {

namespace {

// The scalar product, summed in two parts because this is faster.
double dot(const double* a, const double* b, int n) {
    double even = 0.0, odd = 0.0;
    int i = 0;
    for (; i + 1 < n; i += 2) {
        even += a[i] * b[i];
        odd += a[i + 1] * b[i + 1];
    }
    return even + odd + (i < n ? a[i] * b[i] : 0.0);
}

// Reduce a symmetric matrix, given by its lower triangle, to tridiagonal form by Householder
// reflections: `d` becomes the diagonal, e[1..] the subdiagonal and the rows of `w` the basis of
// the tridiagonal form. `v` is overwritten.
template <int SIZE>
void tridiagonalise(double* v, double* w, double* d, double* e, int size) {
    const int n = SIZE ? SIZE : size;
    for (int i = n - 1; i > 0; --i) {
        double* row = v + i * n;
        double scale = 0.0, h = 0.0;
        for (int k = 0; k < i; ++k) scale += std::fabs(row[k]);
        if (i == 1 || scale == 0.0) {
            e[i] = row[i - 1];
            d[i] = 0.0;
            continue;
        }
        const double inverse = 1.0 / scale;
        for (int k = 0; k < i; ++k) row[k] *= inverse;
        h = dot(row, row, i);
        const double last = row[i - 1], root = std::sqrt(h);
        const double g = last >= 0.0 ? -root : root;
        e[i] = scale * g;
        h -= last * g;
        row[i - 1] = last - g;
        std::fill(e, e + i, 0.0);
        for (int j = 0; j < i; ++j) {
            const double* lower = v + j * n;
            const double entry = row[j];
            for (int k = 0; k < j; ++k) e[k] += lower[k] * entry;
            e[j] += dot(lower, row, j + 1);
        }
        const double reciprocal = 1.0 / h;
        const double half = 0.5 * reciprocal * reciprocal * dot(e, row, i);
        for (int j = 0; j < i; ++j) e[j] = e[j] * reciprocal - half * row[j];
        for (int j = 0; j < i; ++j) {
            double* lower = v + j * n;
            const double f = row[j], q = e[j];
            for (int k = 0; k <= j; ++k) lower[k] -= f * e[k] + q * row[k];
        }
        d[i] = h;
    }
    d[0] = e[0] = 0.0;
    std::fill(w, w + n * n, 0.0);
    for (int i = 0; i < n; ++i) {
        const double* row = v + i * n;
        if (d[i] != 0.0) {
            for (int j = 0; j < i; ++j) {
                double* vector = w + j * n;
                const double share = dot(row, vector, i) / d[i];
                for (int k = 0; k < i; ++k) vector[k] -= share * row[k];
            }
        }
        d[i] = row[i];
        w[i * n + i] = 1.0;
    }
}

// Diagonalise a tridiagonal matrix by implicit QL steps: `d` becomes the eigenvalues and the
// rows of `w` the eigenvectors. Return false if it does not converge.
template <int SIZE>
bool diagonalise(double* w, double* d, double* e, int size) {
    const int n = SIZE ? SIZE : size;
    const double epsilon = std::numeric_limits<double>::epsilon();
    for (int i = 1; i < n; ++i) e[i - 1] = e[i];
    e[n - 1] = 0.0;
    for (int l = 0; l < n; ++l) {
        for (int iteration = 0;; ++iteration) {
            int m = l;
            for (; m < n - 1; ++m) {
                if (std::fabs(e[m]) <= epsilon * (std::fabs(d[m]) + std::fabs(d[m + 1]))) break;
            }
            if (m == l) break;
            if (iteration == 60) return false;
            double g = (d[l + 1] - d[l]) / (2.0 * e[l]);
            double r = std::sqrt(g * g + 1.0);
            g = d[m] - d[l] + e[l] / (g + std::copysign(r, g));
            double s = 1.0, c = 1.0, p = 0.0;
            int i = m - 1;
            for (; i >= l; --i) {
                const double f = s * e[i], b = c * e[i];
                r = std::sqrt(f * f + g * g);
                e[i + 1] = r;
                if (r == 0.0) {
                    d[i + 1] -= p;
                    e[m] = 0.0;
                    break;
                }
                const double inverse = 1.0 / r;
                s = f * inverse;
                c = g * inverse;
                g = d[i + 1] - p;
                r = (d[i] - g) * s + 2.0 * c * b;
                p = s * r;
                d[i + 1] = g + p;
                g = c * r - b;
                double *here = w + i * n, *next = here + n;
                for (int k = 0; k < n; ++k) {
                    const double old = next[k];
                    next[k] = s * here[k] + c * old;
                    here[k] = c * here[k] - s * old;
                }
            }
            if (r == 0.0 && i >= l) continue;
            d[l] -= p;
            e[l] = g;
            e[m] = 0.0;
        }
    }
    return true;
}

// Try a Cholesky factorisation of a symmetric matrix. `space` holds size * size numbers.
template <int SIZE>
bool is_positive_definite(const double* matrix, int order, double* space) {
    const int size = SIZE ? SIZE : order;
    for (int j = 0; j < size; ++j)
        for (int i = j; i < size; ++i) space[j * size + i] = matrix[i * size + j];
    for (int j = 0; j < size; ++j) {
        const double* row = space + j * size;
        if (!(row[j] > 0.0)) return false;
        const double inverse = 1.0 / row[j];
        for (int i = j + 1; i < size; ++i) {
            const double multiplier = row[i] * inverse;
            for (int k = i; k < size; ++k) space[i * size + k] -= multiplier * row[k];
        }
    }
    return true;
}

// find_negative_part for a SIZE that is known when compiling, or for any order (SIZE = 0).
template <int SIZE>
void find_negative_part_sized(double* matrix, int order, double* space) {
    const int size = SIZE ? SIZE : order;
    if (is_positive_definite<SIZE>(matrix, size, space)) {
        std::fill(matrix, matrix + size * size, 0.0);
        return;
    }
    double *vectors = space + size * size, *values = vectors + size * size;
    double* subdiagonal = values + size;
    std::copy(matrix, matrix + size * size, space);
    tridiagonalise<SIZE>(space, vectors, values, subdiagonal, size);
    const bool converged = diagonalise<SIZE>(vectors, values, subdiagonal, size);
    std::fill(matrix, matrix + size * size, 0.0);
    for (int k = 0; k < size; ++k) {
        // Without convergence the matrix becomes infinite, and so the step fails.
        const double shift = converged ? -values[k] : std::numeric_limits<double>::infinity();
        if (!(shift > 0.0)) continue;
        const double* vector = vectors + k * size;
        for (int i = 0; i < size; ++i) {
            const double scaled = shift * vector[i];
            for (int j = 0; j <= i; ++j) matrix[i * size + j] += scaled * vector[j];
        }
    }
}

}  // namespace

// Sizes 3 U of 1 to 4 UAVs have versions of their own, which are faster.
void find_negative_part(double* matrix, int size, double* space) {
    switch (size) {
        case 3: return find_negative_part_sized<3>(matrix, size, space);
        case 6: return find_negative_part_sized<6>(matrix, size, space);
        case 9: return find_negative_part_sized<9>(matrix, size, space);
        case 12: return find_negative_part_sized<12>(matrix, size, space);
        default: return find_negative_part_sized<0>(matrix, size, space);
    }
}

// Gaussian elimination with row pivots; the solution replaces the right side.
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
