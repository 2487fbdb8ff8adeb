// A square-root unscented Kalman filter as one writes it by hand in C for one model: the speed to compare with.
//
// The array form of `servohil.estimators.SRUKF` (two QR decompositions) for the cylinder, -DN=4, and for the cylinder
// with seven random-walk parameters, -DN=11. Sizes are fixed at compile time, columns are contiguous so that the loops
// over the rows vectorise, nothing is checked, no channel is ever missing, there is no gate.
#include <math.h>

#ifndef N
#define N 4
#endif
#define M 3
#define N_U 3
#define POINTS (2 * N + 1)
#define ROWS (POINTS + N)

enum { MASS, FRICTION, AREA_A, AREA_B, V0_A, V0_B, STROKE, BULK, CS, K_I, K_EA, K_EB, AMBIENT, LOAD };

static inline double signed_sqrt(double dp) { return dp / sqrt(sqrt(dp * dp + 1e-6)); }

static inline void f(const double *x, const double *u, const double *p, double *dx)
{
    double position = fmin(fmax(x[0], 0.0), p[STROKE]);
    double supply = u[1] * 1e-6, tank = u[2] * 1e-6, ambient = p[AMBIENT] * 1e-6;
    double gain = p[CS] * 1e3, friction = p[FRICTION], bulk = p[BULK] * 1e-6, load = p[LOAD];
    double leak_i = p[K_I] * 1e6, leak_a = p[K_EA] * 1e6, leak_b = p[K_EB] * 1e6;
#if N == 11
    gain *= x[4];
    friction *= x[5];
    bulk *= x[6];
    load += 1e3 * x[7];
    leak_i += 1e-5 * x[8];
    leak_a += 1e-5 * x[9];
    leak_b += 1e-5 * x[10];
#endif
    double flow_a, flow_b;
    if (u[0] >= 0.0) {
        flow_a = gain * u[0] * signed_sqrt(supply - x[2]);
        flow_b = gain * u[0] * signed_sqrt(x[3] - tank);
    } else {
        flow_a = gain * u[0] * signed_sqrt(x[2] - tank);
        flow_b = gain * u[0] * signed_sqrt(supply - x[3]);
    }
    double internal = leak_i * (x[2] - x[3]);
    double external_a = leak_a * (x[2] - ambient), external_b = leak_b * (x[3] - ambient);
    double volume_a = p[AREA_A] * position + p[V0_A];
    double volume_b = p[AREA_B] * (p[STROKE] - position) + p[V0_B];
    double force = (p[AREA_A] * x[2] - p[AREA_B] * x[3]) * 1e6;
    dx[0] = x[1];
    dx[1] = (force - friction * x[1] - load) / p[MASS];
    dx[2] = bulk / volume_a * (flow_a - p[AREA_A] * x[1] - internal - external_a);
    dx[3] = bulk / volume_b * (-flow_b + p[AREA_B] * x[1] + internal - external_b);
    for (int i = 4; i < N; i++)
        dx[i] = 0.0;
}

static inline void h(const double *x, double *y)
{
    y[0] = x[0];
    y[1] = x[2];
    y[2] = x[3];
}

static inline void rk4(double *x, const double *u, const double *p, double dt)
{
    double k1[N], k2[N], k3[N], k4[N], z[N];
    f(x, u, p, k1);
    for (int i = 0; i < N; i++)
        z[i] = x[i] + 0.5 * dt * k1[i];
    f(z, u, p, k2);
    for (int i = 0; i < N; i++)
        z[i] = x[i] + 0.5 * dt * k2[i];
    f(z, u, p, k3);
    for (int i = 0; i < N; i++)
        z[i] = x[i] + dt * k3[i];
    f(z, u, p, k4);
    for (int i = 0; i < N; i++)
        x[i] += dt / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
}

// Householder QR of a (rows, columns), stored by columns: its upper triangle becomes R, diagonal >= 0.
static inline void triangularise(double a[][ROWS], int rows, int columns)
{
    for (int k = 0; k < columns; k++) {
        double head = a[k][k], tail = 0.0;
        for (int i = k + 1; i < rows; i++)
            tail += a[k][i] * a[k][i];
        if (tail == 0.0) {
            for (int j = k; head < 0.0 && j < columns; j++)
                a[j][k] = -a[j][k];
            continue;
        }
        double norm = sqrt(head * head + tail);
        double v = head <= 0.0 ? head - norm : -tail / (head + norm);
        double scale = 2.0 / (v * v + tail);
        for (int j = k + 1; j < columns; j++) {
            double s = v * a[j][k];
            for (int i = k + 1; i < rows; i++)
                s += a[k][i] * a[j][i];
            s *= scale;
            a[j][k] -= v * s;
            for (int i = k + 1; i < rows; i++)
                a[j][i] -= s * a[k][i];
        }
        a[k][k] = norm;
    }
}

static inline void draw(const double *x, double factor[N][N], double spread, double points[POINTS][N])
{
    for (int j = 0; j < N; j++)
        points[0][j] = x[j];
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            points[1 + i][j] = x[j] + spread * factor[i][j];
            points[1 + N + i][j] = x[j] - spread * factor[i][j];
        }
}

// Column of the stack: weighted deviations of `count` points from their mean, which it returns.
static inline double deviations(const double *points, int stride, double root_centre, double outer, double *column)
{
    double sum = 0.0, root_outer = sqrt(outer);
    for (int i = 1; i < POINTS; i++)
        sum += points[i * stride] - points[0];
    double mean = points[0] + outer * sum;
    column[0] = root_centre * (points[0] - mean);
    for (int i = 1; i < POINTS; i++)
        column[i] = root_outer * (points[i * stride] - mean);
    return mean;
}

static void step(double *restrict x, double factor[restrict N][N], const double q[restrict N][N],
                 const double r[restrict M][M], double spread, double root_centre, double outer,
                 const double *restrict p, const double *restrict u, const double *restrict y, double dt)
{
    double points[POINTS][N], outputs[POINTS][M], stack[N + M][ROWS], mean[N], e[M];
    draw(x, factor, spread, points);
    for (int i = 0; i < POINTS; i++)
        rk4(points[i], u, p, dt);
    for (int j = 0; j < N; j++) {
        mean[j] = deviations(&points[0][j], N, root_centre, outer, stack[j]);
        for (int i = 0; i < N; i++)
            stack[j][POINTS + i] = q[i][j];
    }
    triangularise(stack, POINTS + N, N);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++)
            factor[i][j] = j >= i ? stack[j][i] : 0.0;

    draw(mean, factor, spread, points);
    for (int i = 0; i < POINTS; i++)
        h(points[i], outputs[i]);
    for (int c = 0; c < M; c++) {
        e[c] = y[c] - deviations(&outputs[0][c], M, root_centre, outer, stack[c]);
        for (int i = 0; i < M; i++)
            stack[c][POINTS + i] = r[i][c];
    }
    for (int j = 0; j < N; j++) {
        stack[M + j][0] = 0.0;
        for (int i = 1; i < POINTS; i++)
            stack[M + j][i] = sqrt(outer) * (points[i][j] - mean[j]);
        for (int i = 0; i < M; i++)
            stack[M + j][POINTS + i] = 0.0;
    }
    triangularise(stack, POINTS + M, M + N);
    for (int c = 0; c < M; c++) {
        for (int k = 0; k < c; k++)
            e[c] -= stack[c][k] * e[k];
        e[c] /= stack[c][c];
    }
    for (int j = 0; j < N; j++) {
        x[j] = mean[j];
        for (int c = 0; c < M; c++)
            x[j] += stack[M + j][c] * e[c];
        for (int i = 0; i < N; i++)
            factor[i][j] = j >= i ? stack[M + j][M + i] : 0.0;
    }
}

// x (N) and factor (N, N), the transposed lower factor of P, are moved on over all steps; q (N, N) and r (M, M) are
// factors likewise; u (steps, N_U), y (steps, M); out (steps, N) is filled with the estimates.
void run(long steps, double *x, double *factor, const double *q, const double *r, double spread, double root_centre,
         double outer, const double *p, const double *u, const double *y, double dt, double *out)
{
    for (long k = 0; k < steps; k++) {
        step(x, (double(*)[N])factor, (const double(*)[N])q, (const double(*)[M])r, spread, root_centre, outer, p,
             u + N_U * k, y + M * k, dt);
        for (int j = 0; j < N; j++)
            out[N * k + j] = x[j];
    }
}
