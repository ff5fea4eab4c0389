/* The loop of docs/play.md: the exported controller on the plant, whose commands arrive D late. The controller is
 * npred_..., ADVANCE the plant's step and read_sensors the noise, all as in npred.simulate; STEPS, EVERY, ROWS and
 * START are macros. */
enum { N = NPRED_N_STATES, M = NPRED_M_INPUTS, WIDTH = N + M + 1 };

static npred_controller controller;
static double held[ROWS * M], total[ROWS * M], u[NPRED_NX * M], u_nodes[NPRED_NX * M];
static double record[(STEPS / EVERY + 1) * WIDTH];

/* The law without prediction, U = kappa(X). */
static void control_now(const double *X, double t, double *U)
{
    const double D_hat = 0.0;
    double P[2 * N];
    Shape d = the_shape;
    d.nx = 2;
    copy(N, X, P);
    copy(N, X, P + N);
    the_parts.control(d, P, NULL, &D_hat, t, the_p, U, controller.work);
    clip(the_shape, the_input_bounds, U);
}

/* Rows of X, U and D_hat, one each EVERY control steps; NaN after the loop overflows. */
const double *play(double D, double D_hat, double gamma, double noise, int predicts)
{
    const double zeros[N] = {0.0};
    double X[N] = START, Y[N], U[M] = {0.0}, U0[M], U1[M], share[M], late[M], noises[N];
    Settings sensors = {.relative_noise = noises, .noise = (double *)zeros, .bias = (double *)zeros,
                        .resolution = (double *)zeros};
    Shape d = the_shape;
    d.rows = ROWS;
    fill(N, noise, noises);
    fill(M, D, late);
    fill(ROWS * M, 0.0, held);
    fill(ROWS * M, 0.0, total);
    npred_init(&controller);
    npred_set_D_hat(&controller, D_hat);
    controller.settings.gamma_dt = gamma * NPRED_DT;
    for (int k = 0; k <= STEPS; k++) {
        const int at = ROWS - 1 + k; /* the commands before t = 0 are there too */
        const double t = k * NPRED_DT, estimate = predicts ? controller.saved.D_hat[0] : 0.0;
        read_sensors(N, 1, &sensors, 0, k, X, Y);
        transport(d, at, 0.0, NPRED_DT, late, held, total, u, u_nodes);
        if (!predicts) {
            control_now(Y, t, U);
        } else if (npred_step_nodes(&controller, Y, u, u_nodes, U) != NPRED_OK) {
            fill(M, NAN, U);
        }
        if (k % EVERY == 0) {
            double *row = record + k / EVERY * WIDTH;
            copy(N, X, row);
            copy(M, U, row + N);
            row[N + M] = estimate;
        }
        actuate(d, at, NPRED_DT, late, U, held, total, U0, U1, share);
        ADVANCE(d, X, U0, U1, share, NPRED_DT, t, the_p, controller.work);
    }
    return record;
}
