/* Training of the three-state MDP (§3.1 of the paper) in straight C: what `rl.train` computes, and nothing else.

   GPOMDP with the weights "paper", corrected averages, the step `equality` on the constraints with ρ ≤ 0. Sizes are
   constants, so that the compiler unrolls. Nothing is checked, certified or recorded; a Δ¹ without a tangent part,
   which the drop rule would look at, is taken for a step of length 0. */

#include <math.h>
#include <stdint.h>

enum { S = 3, A = 3, N = S * A, CHANNELS = 4, M = CHANNELS - 1, STEPS = 100, RUNS = 20 };

static const double BETA = 0.99, RATE = 0.02, STEP_SIZE = 0.02, RESTORATION_RATE = 0.02, DEPENDENT = 1e-6;

typedef struct { double theta[N], rho[CHANNELS]; uint64_t random[4]; } Run;
typedef struct { double rewards[N][CHANNELS]; int64_t next[N][S]; } Mdp; /* next: least draws beyond each state */
typedef struct { double mu[N]; int64_t beyond[N]; } Policy;

static uint64_t rotated(uint64_t word, int bits) { return word << bits | word >> (64 - bits); }

/* xoshiro256++ */
static uint64_t next_word(uint64_t s[4]) {
    uint64_t word = rotated(s[0] + s[3], 23) + s[0], shifted = s[1] << 17;
    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= shifted;
    s[3] = rotated(s[3], 45);
    return word;
}

static int drawn(const int64_t beyond[3], int64_t draw) { return (draw >= beyond[0]) + (draw >= beyond[1]); }

static void tabulate(const double theta[N], Policy *policy) {
    for (int s = 0; s < S; s++) {
        const double *h = theta + s * A;
        double *mu = policy->mu + s * A, largest = fmax(fmax(h[0], h[1]), h[2]), total = 0, below = 0;
        for (int a = 0; a < A; a++) total += mu[a] = exp(h[a] - largest);
        for (int a = 0; a < A; a++) {
            mu[a] /= total;
            below += mu[a];
            policy->beyond[s * A + a] = (int64_t)ceil(below * 4294967296.0);
        }
    }
}

/* One word a step: its high half draws the action, its low half the next state. Runs in the inner loop, so that the
   processor works on several chains of dependent steps at once. */
static void simulate(const Mdp *mdp, const Policy policies[RUNS], Run runs[RUNS], uint8_t visits[STEPS][RUNS]) {
    int state[RUNS] = {0};
    for (int t = 0; t < STEPS; t++)
        for (int b = 0; b < RUNS; b++) {
            uint64_t word = next_word(runs[b].random);
            int q = state[b] * A + drawn(policies[b].beyond + state[b] * A, (int64_t)(word >> 32));
            visits[t][b] = (uint8_t)q;
            state[b] = drawn(mdp->next[q], (int64_t)(word & 0xFFFFFFFF));
        }
}

/* Eq. 3 and 4, summed from the end: each score meets the rewards that follow it. */
static void estimate(const Mdp *mdp, const Policy *policy, int b, uint8_t visits[STEPS][RUNS], double kept,
                     double rho[CHANNELS], double gradients[CHANNELS][N]) {
    double later[CHANNELS] = {0}, recent[CHANNELS] = {0}, gathered[N][CHANNELS] = {{0}}, weight = RATE;
    for (int t = STEPS - 1; t > 0; t--) {
        int q = visits[t][b];
        for (int i = 0; i < CHANNELS; i++) {
            double r = mdp->rewards[q][i];
            gathered[q][i] += r + later[i];
            later[i] = r + BETA * later[i];
            recent[i] += weight * r;
        }
        weight *= 1 - RATE;
    }
    for (int i = 0; i < CHANNELS; i++) {
        gathered[visits[0][b]][i] += later[i]; /* r(x₀, u₀) itself does not enter */
        rho[i] = kept * rho[i] + recent[i];
        for (int s = 0; s < S; s++) {
            double total = gathered[s * A][i] + gathered[s * A + 1][i] + gathered[s * A + 2][i];
            for (int q = s * A; q < s * A + A; q++)
                gradients[i][q] = (gathered[q][i] - policy->mu[q] * total) / (STEPS - 1);
        }
    }
}

static double dot(const double x[N], const double y[N]) {
    double sum = 0;
    for (int j = 0; j < N; j++) sum += x[j] * y[j];
    return sum;
}

static void add(double x[N], double c, const double y[N]) {
    for (int j = 0; j < N; j++) x[j] += c * y[j];
}

/* argmin ‖C y − t‖ by CᵀC y = Cᵀt, C of full column rank. */
static void least_squares(int rows, int size, double C[M][M], const double t[M], double y[M]) {
    double square[M][M] = {{0}};
    for (int k = 0; k < size; k++) {
        y[k] = 0;
        for (int i = 0; i < rows; i++) {
            y[k] += C[i][k] * t[i];
            for (int l = 0; l < size; l++) square[k][l] += C[i][k] * C[i][l];
        }
        for (int l = 0; l < k; l++) {
            double c = square[k][l] / square[l][l];
            y[k] -= c * y[l];
            for (int j = l; j < size; j++) square[k][j] -= c * square[l][j];
        }
    }
    for (int k = size - 1; k >= 0; k--) {
        for (int l = k + 1; l < size; l++) y[k] -= square[k][l] * y[l];
        y[k] /= square[k][k];
    }
}

/* θ += α₁ PΔ¹ + αₑ v. The active unit rows are C Q: Q orthonormal by two passes of Gram-Schmidt, rows that depend on
   those before left out. v = Ĵ⁺t by substitution, or by least squares where a row depends, for t may contradict it. */
static void step(const double slack[M], double gradients[CHANNELS][N], double theta[N]) {
    double Q[M][N], C[M][M] = {{0}}, target[M], y[M], tangent[N];
    int rows = 0, size = 0;
    for (int j = 0; j < N; j++) tangent[j] = gradients[0][j];
    for (int i = 0; i < M; i++) {
        double length = sqrt(dot(gradients[i + 1], gradients[i + 1])), *q = Q[size];
        if (slack[i] > 0 || length == 0) continue;
        for (int j = 0; j < N; j++) q[j] = gradients[i + 1][j] / length;
        target[rows] = -slack[i] / length;
        for (int pass = 0; pass < 2; pass++)
            for (int k = 0; k < size; k++) {
                double c = dot(Q[k], q);
                add(q, -c, Q[k]);
                C[rows][k] += c;
            }
        length = sqrt(dot(q, q));
        if (length >= DEPENDENT) {
            for (int j = 0; j < N; j++) q[j] /= length;
            for (int pass = 0; pass < 2; pass++) add(tangent, -dot(q, tangent), q);
            C[rows][size++] = length;
        }
        rows++;
    }
    if (size < rows) least_squares(rows, size, C, target, y);
    else
        for (int i = 0; i < size; i++) {
            y[i] = target[i];
            for (int k = 0; k < i; k++) y[i] -= C[i][k] * y[k];
            y[i] /= C[i][i];
        }
    add(theta, STEP_SIZE, tangent);
    for (int k = 0; k < size; k++) add(theta, RESTORATION_RATE * y[k], Q[k]);
}

/* θ, ρ and the random states are advanced in place. */
void train(const Mdp *mdp, Run runs[RUNS], int episodes) {
    static uint8_t visits[STEPS][RUNS];
    static Policy policies[RUNS];
    double kept = pow(1 - RATE, STEPS - 1), weights = 0;
    for (int episode = 0; episode < episodes; episode++) {
        for (int b = 0; b < RUNS; b++) tabulate(runs[b].theta, &policies[b]);
        simulate(mdp, policies, runs, visits);
        weights += (1 - kept) * (1 - weights);
        for (int b = 0; b < RUNS; b++) {
            double gradients[CHANNELS][N], slack[M];
            estimate(mdp, &policies[b], b, visits, kept, runs[b].rho, gradients);
            for (int i = 0; i < M; i++) slack[i] = runs[b].rho[i + 1] / weights;
            step(slack, gradients, runs[b].theta);
        }
    }
}
